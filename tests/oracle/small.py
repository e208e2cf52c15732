"""A cinema small enough to work out every look-up by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.domain import Action, Domain, Goal, ScriptedPolicySpec

from .dialogue import Dialogue, Setting, World

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SLOTS = (
    *("moviename", "city", "date", "theater", "genre"),
    *("numberofpeople", "ticket", "taskcomplete"),
)
ACTS = (
    *("request", "inform", "confirm_question", "confirm_answer", "greeting"),
    *("closing", "multiple_choice", "thanks", "deny"),
)
ACTIONS = (
    *("greeting", "thanks", "deny", "confirm_question", "confirm_answer", "closing"),
    *(f"request({slot})" for slot in SLOTS[:6]),
    *(f"inform({slot})" for slot in (*SLOTS[:5], "taskcomplete", "ticket")),
    *("multiple_choice(theater)", "multiple_choice(city)"),
)
RECORDS = (
    {"moviename": "Deadpool", "city": "Seattle", "date": "today", "theater": "Roxy"},
    {"moviename": "deadpool", "city": "seattle", "date": "today", "theater": "Odeon"},
    {"moviename": "deadpool", "city": "seattle", "date": "tomorrow", "theater": "Odeon"},
    {"moviename": "deadpool", "city": "boston", "date": "today", "theater": "Lux"},
    {"moviename": "zootopia", "city": "boston", "genre": "comedy", "numberofpeople": "2"},
)
ERROR_VALUES = {
    "moviename": ("deadpool", "zootopia"),
    "city": ("seattle", "boston"),
    "date": ("today", "tomorrow", "friday"),
}

ALMOST_ONE = 1 - 2**-24

GOAL = {"moviename": "deadpool", "city": "seattle", "numberofpeople": "2"}


def action(text: str) -> Action:
    """Returns the action that is written ``act`` or ``act(slot)``."""
    act, _, slot = text.removesuffix(")").partition("(")
    return Action(act, slot or None)


def small_domain(*goals: Goal, records: Sequence[Mapping[str, str]] = RECORDS) -> Domain:
    """Returns the small cinema with these goals."""
    return Domain(
        name="small",
        acts=ACTS,
        slots=SLOTS,
        actions=tuple(map(action, ACTIONS)),
        essential=("city", "numberofpeople", "ticket", "taskcomplete"),
        extension_order=("moviename", "date", "theater", "genre"),
        free_slots=("numberofpeople", "ticket", "taskcomplete"),
        ticket_slot="ticket",
        complete_slot="taskcomplete",
        opening_slot="moviename",
        turn_width=10,
        policies={
            "short": ScriptedPolicySpec("script", ("inform(taskcomplete)", "thanks")),
            "careful": ScriptedPolicySpec("careful", ("city", "date", "numberofpeople")),
        },
        reference_slot_error_prob=0.0,
        records=tuple(records),
        goals=goals,
        error_values=ERROR_VALUES,
    )


def draws(**chosen: Any) -> dict[str, Any]:
    """Returns draws that hit nothing; `agenda="city"` makes a slot the choice of that draw.

    A dict gives single slots their uniforms, a number gives it to all of them.
    """
    result: dict[str, Any] = {"goal": 0.0, "intent": ALMOST_ONE, "intent_act": 0.0, "offer": 0.0}
    names = ("constraint", "request", "agenda", "error", "error_kind", "error_slot", "error_value")
    for name in names:
        result[name] = [ALMOST_ONE if name == "error" else 0.0] * len(SLOTS)
    for name, choice in chosen.items():
        if isinstance(choice, str):
            choice = {choice: ALMOST_ONE}
        if isinstance(choice, dict):
            for slot, u in choice.items():
                result[name][SLOTS.index(slot)] = u
        elif isinstance(result[name], list):
            result[name] = [choice] * len(SLOTS)
        else:
            result[name] = choice
    return result


def start(
    constraints: dict[str, str],
    requests: tuple[str, ...] = (),
    *,
    first: dict[str, Any] | None = None,
    **setting: Any,
) -> Dialogue:
    """Returns a dialogue about one goal in the small cinema, after the user's first act."""
    world = World(small_domain(Goal(constraints, requests)), Setting(**setting))
    return Dialogue(world, draws(**(first or {})))


def say(dialogue: Dialogue, *actions: str, **chosen: Any) -> None:
    """Plays agent acts; the draws are those of every one of the turns."""
    for text in actions:
        dialogue.turn(action(text), draws(**chosen))
