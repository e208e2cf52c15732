"""A cinema with a handful of showings, and a way to put its dialogues into any situation."""

from __future__ import annotations

from typing import Any

import torch

from bbq_torchrl.domains import Action, Domain, Goal, tensorize
from bbq_torchrl.simulator import ErrorModel, Simulator

SLOTS = ("movie", "city", "date", "theater", "genre", "people", "ticket", "done")
ACTS = (
    *("request", "inform", "confirm_question", "confirm_answer", "greeting"),
    *("closing", "multiple_choice", "thanks", "deny"),
)
ACTIONS = (
    *("greeting", "thanks", "deny", "confirm_question", "confirm_answer", "closing"),
    *(f"request({slot})" for slot in ("movie", "city", "date", "theater", "genre", "people")),
    *(f"inform({slot})" for slot in ("movie", "city", "date", "theater", "genre", "ticket")),
    "inform(done)",
    "multiple_choice(theater)",
)
SHOWINGS = (
    {"movie": "deadpool", "city": "seattle", "date": "today", "theater": "roxy"},
    {"movie": "deadpool", "city": "seattle", "date": "friday", "theater": "odeon"},
    {"movie": "deadpool", "city": "boston", "date": "today", "theater": "odeon"},
    {"movie": "zootopia", "city": "boston", "theater": "lux", "people": "9"},
)
ERROR_VALUES = {
    "movie": ("deadpool", "zootopia"),
    "city": ("seattle", "boston", "austin"),
    "date": ("today", "friday", "sunday"),
}
NEVER = 1 - 2**-24  # the largest number drawn: it hits nothing


def cinema(
    *goals: Goal, showings: Any = SHOWINGS, opening: str | tuple[str, ...] | None = "movie"
) -> Domain:
    """Returns the cinema with these goals."""
    return Domain(
        name="cinema",
        acts=ACTS,
        slots=SLOTS,
        actions=tuple(Action.parse(text) for text in ACTIONS),
        essential=("movie", "people", "ticket", "done"),
        extension_order=("city", "date", "theater"),
        free_slots=("people", "ticket", "done"),
        ticket_slot="ticket",
        complete_slot="done",
        opening_slot=opening,
        turn_width=8,
        policies={},
        reference_slot_error_prob=0.0,
        records=showings,
        goals=goals,
        error_values=ERROR_VALUES,
    )


class Scene:
    """One user of the cinema; values, slots and acts go in and come out as text."""

    def __init__(
        self,
        constraints: dict[str, str] | None = None,
        requests: tuple[str, ...] = (),
        *,
        active: tuple[str, ...] = SLOTS,
        max_turn: int = 40,
        showings: Any = SHOWINGS,
        opening: str | tuple[str, ...] | None = "movie",
        **errors: Any,
    ) -> None:
        goal = Goal(constraints or {}, requests)
        self.domain = tensorize(cinema(goal, showings=showings, opening=opening))
        self.simulator = Simulator(
            self.domain, errors=ErrorModel(self.domain, **errors), max_turn=max_turn
        )
        self.active = torch.tensor([slot in active for slot in SLOTS])

    def start(self, **draws: Any) -> Any:
        """Returns the state after the user's first turn; draws as in :meth:`say`."""
        names = {"goal": (), "constraint": (len(SLOTS),), "request": (len(SLOTS),)}
        return self.simulator.reset(self._draws(names, draws), self.active)

    def situation(self, **entries: Any) -> Any:
        """Returns a state in the middle of the dialogue, with these entries.

        Nothing is on the agenda, pending, said or held but what the entries say.
        """
        state = self.start()
        empty = {"agenda": (), "pending": (), "history": {}, "user_informs": {}, "held": {}}
        for key, value in (empty | entries).items():
            state[key] = self._encode(state[key], value)
        return state

    def say(self, state: Any, *actions: str, **draws: Any) -> Any:
        """Plays the agent's actions; ``draws`` are those of each of the turns.

        The name of a slot makes it the choice of that draw, a dict gives slots their numbers.
        """
        names = {
            key: (len(SLOTS),)
            for key in ("agenda", "error", "error_kind", "error_slot", "error_value")
        }
        names |= {"intent": (), "intent_act": (), "offer": ()}
        for action in actions:
            index = torch.tensor(ACTIONS.index(action))
            drawn = self._draws(names, {"error": NEVER, "intent": NEVER} | draws)
            state = self.simulator.turn(state, index, drawn, self.active)
        return state

    def values(self, ids: torch.Tensor) -> dict[str, str]:
        """Returns the values that a row of ids stands for."""
        texts = zip(SLOTS, self.domain.vocabulary, ids.tolist(), strict=True)
        return {slot: words[value] for slot, words, value in texts if value}

    @staticmethod
    def slots(flags: torch.Tensor) -> set[str]:
        """Returns the slots that are flagged."""
        return {slot for slot, flag in zip(SLOTS, flags.tolist(), strict=True) if flag}

    def user(self, state: Any) -> tuple[str, dict[str, str], set[str]]:
        """Returns what the user said: act, what was transmitted of its informs, requests."""
        told = self.values(state["user_informs"])
        return ACTS[int(state["user_act"])], told, self.slots(state["pending"])

    def id(self, slot: str, text: str) -> int:
        """Returns the id of a value."""
        return self.domain.vocabulary[SLOTS.index(slot)].index(text)

    def _encode(self, like: torch.Tensor, value: Any) -> torch.Tensor:
        if isinstance(value, dict):
            return torch.tensor([self.id(s, value[s]) if s in value else 0 for s in SLOTS])
        if isinstance(value, tuple):
            return torch.tensor([slot in value for slot in SLOTS])
        if isinstance(value, str):
            value = ACTS.index(value)
        return torch.full_like(like, value)

    @staticmethod
    def _draws(names: dict[str, tuple[int, ...]], chosen: dict[str, Any]) -> Any:
        from tensordict import TensorDict

        draws = TensorDict({key: torch.zeros(shape) for key, shape in names.items()}, [])
        for key, value in chosen.items():
            if isinstance(value, str):
                value = {value: NEVER}
            if isinstance(value, dict):
                for slot, number in value.items():
                    draws[key][SLOTS.index(slot)] = number
            else:
                draws[key].fill_(value)
        return draws
