"""The checks that every domain passes on construction."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from bbq_torchrl.domains.faults import DomainError, Fault
from bbq_torchrl.domains.values import DONT_CARE, RESERVED_TEXT, fold
from bbq_torchrl.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from bbq_torchrl.domains.domain import Domain
    from bbq_torchrl.domains.faults import Place

__all__ = [
    "ACTION_KINDS",
    "MAX_TURN_WIDTH",
    "PRIVILEGED_POLICY",
    "RANDOM_POLICY",
    "REQUIRED_ACTS",
    "check_domain",
    "repeated",
]

REQUIRED_ACTS = (
    "request",
    "inform",
    "confirm_question",
    "confirm_answer",
    "greeting",
    "closing",
    "multiple_choice",
    "thanks",
    "deny",
)
"""The acts whose meaning the user simulator knows; a domain may add others."""

ACTION_KINDS = ("act", "request", "inform", "multiple_choice")
"""In the order of the actions: those without a slot, then those that carry one."""

MAX_TURN_WIDTH = 1_000
"""The widest one-hot turn: a feature each, in every observation."""

RANDOM_POLICY = "random"
"""The name of the policy that every domain has besides its own."""

PRIVILEGED_POLICY = "clairvoyant"
"""The name of the policy that reads the user's hidden goal, to set a ceiling beside agents."""

_RESERVED = {fold(text): key for key, text in RESERVED_TEXT.items()}


def check_domain(domain: Domain) -> None:
    """Checks that names, special slots, actions, policies and data fit together.

    Raises:
        DomainError: with every fault: key, value and what is allowed.
    """
    found = [
        *_names(domain),
        *_special_slots(domain),
        *_actions(domain),
        *_policies(domain),
        *_numbers(domain),
        *_records(domain),
        *_goals(domain),
        *_error_values(domain),
    ]
    if found:
        raise DomainError(f"domain {shown(domain.name)}", found)


def _names(domain: Domain) -> Iterator[Fault]:
    if not domain.name:
        yield Fault(("name",), "name of a domain must not be empty")
    for key in ("acts", "slots", "essential", "extension_order", "free_slots"):
        names: tuple[str, ...] = getattr(domain, key)
        if twice := repeated(names):
            yield Fault((key,), f"{key} must be distinct, got {twice} more than once")
    for act in domain.acts:
        if not act.isidentifier():
            yield Fault(("acts",), f"acts must be identifiers, got {shown(act)}")
    for slot in domain.slots:
        # The features have names of their own: "all", and "0", "1", ... of the turn.
        if not re.fullmatch(r"\w+", slot) or slot == "all" or slot.isdigit():
            yield Fault(
                ("slots",),
                f"slots must consist of letters, digits and underscores, not of digits alone, and "
                f"must not be 'all', got {shown(slot)}",
            )
    if missing := [act for act in REQUIRED_ACTS if act not in domain.acts]:
        yield Fault(("acts",), f"acts must contain {list(REQUIRED_ACTS)}, {missing} are missing")
    for key in ("essential", "extension_order", "free_slots"):
        yield from _unknown(domain, (key,), getattr(domain, key), f"{key} names ")
    told = [action.slot for action in domain.actions if action.kind in ACTION_KINDS[2:]]
    known = {*told, *domain.error_values, *(slot for record in domain.records for slot in record)}
    if known <= {*domain.free_slots}:
        yield Fault(
            ("free_slots",),
            "free_slots must leave a slot to constrain the records by, got all that have values",
        )
    if both := [slot for slot in domain.extension_order if slot in domain.essential]:
        yield Fault(
            ("extension_order",),
            f"extension_order must not contain essential slots, got {both} in both",
        )


def _unknown(
    domain: Domain, place: Place, slots: Iterable[str], names: str = "it names "
) -> Iterator[Fault]:
    for slot in slots:
        if slot not in domain.slots:
            yield Fault(
                place,
                f"{names}the unknown slot {shown(slot)}; the slots are {', '.join(domain.slots)}",
            )


def _special_slots(domain: Domain) -> Iterator[Fault]:
    special = {"ticket_slot": domain.ticket_slot, "complete_slot": domain.complete_slot}
    for key, slot in special.items():
        yield from _unknown(domain, (key,), [slot], f"{key} names ")
    if domain.ticket_slot == domain.complete_slot:
        yield Fault(
            ("complete_slot",),
            f"ticket_slot and complete_slot must differ, got {domain.ticket_slot!r} for both",
        )
    for key, slot in special.items():
        for group in ("essential", "free_slots"):
            members: tuple[str, ...] = getattr(domain, group)
            if slot in domain.slots and slot not in members:
                yield Fault(
                    (key,), f"{key} must be among {group}, {slot!r} is not in {list(members)}"
                )
    place = ("opening_slot",)
    yield from _unknown(domain, place, domain.opening_slots, "opening_slot names ")
    if twice := repeated(domain.opening_slots):
        yield Fault(place, f"opening_slot must name a slot once, got {twice} again")
    for slot in domain.opening_slots:
        if slot in domain.special_slots:
            yield Fault(
                place, f"opening_slot must not be the ticket or the complete slot, got {slot!r}"
            )


def _actions(domain: Domain) -> Iterator[Fault]:
    if twice := repeated(domain.action_names):
        yield Fault(("actions",), f"actions must be distinct, got {twice} more than once")
    for action in domain.actions:
        place = ("actions", action.kind)
        if action.act not in domain.acts:
            yield Fault(
                place,
                f"action {action} has the unknown act {action.act!r}; the acts are "
                f"{', '.join(domain.acts)}",
            )
        if action.slot is not None:
            yield from _unknown(domain, place, [action.slot], f"action {action} names ")
        elif action.act in ACTION_KINDS[1:]:
            yield Fault(place, f"action {action} needs a slot, written {action.act}(slot)")
        if action.kind in ("request", "multiple_choice") and action.slot in domain.special_slots:
            yield Fault(place, f"action {action} makes no sense: no user constrains {action.slot}")
    kinds = [ACTION_KINDS.index(action.kind) for action in domain.actions]
    if kinds != sorted(kinds):
        yield Fault(
            ("actions",),
            f"actions must be slotless acts, then requests, informs and multiple choices, "
            f"got {', '.join(domain.action_names)}",
        )
    offer = f"inform({domain.complete_slot})"
    if offer not in domain.action_names:
        yield Fault(("actions",), f"actions must contain {offer}: without it nothing can be booked")
    if not {"thanks", "closing"} & set(domain.action_names):
        yield Fault(
            ("actions",), "actions must contain thanks or closing: no dialogue succeeds without"
        )


def _policies(domain: Domain) -> Iterator[Fault]:
    for name, policy in domain.policies.items():
        key, place = f"policies.{name}", ("policies", name)
        if name in ("", RANDOM_POLICY, PRIVILEGED_POLICY):
            yield Fault(
                place,
                f"policies must have names of their own, not empty, {RANDOM_POLICY} or "
                f"{PRIVILEGED_POLICY}, got {name!r}",
            )
        if policy.kind not in ("script", "careful"):
            yield Fault(
                place, f"{key} must be of kind 'script' or 'careful', got {shown(policy.kind)}"
            )
        if not policy.steps:
            yield Fault(place, f"{key} must have at least one step, got none")
        needed = policy.steps
        if policy.kind == "careful":
            yield from _unknown(domain, place, policy.steps, f"{key} names ")
            known = [slot for slot in policy.steps if slot in domain.slots]
            ending = (f"inform({domain.complete_slot})", "thanks")
            needed = (*(f"request({slot})" for slot in known), *ending)
        for action in needed:
            if action not in domain.action_names:
                yield Fault(
                    place,
                    f"{key} needs the action {shown(action)}, which is not among "
                    f"{', '.join(domain.action_names)}",
                )


def _numbers(domain: Domain) -> Iterator[Fault]:
    if not 1 <= domain.turn_width <= MAX_TURN_WIDTH:
        yield Fault(
            ("turn_width",),
            f"turn_width must be between 1 and {MAX_TURN_WIDTH}, got {shown(domain.turn_width)}",
        )
    if not 0.0 <= domain.reference_slot_error_prob <= 1.0:
        yield Fault(
            ("reference_slot_error_prob",),
            f"reference_slot_error_prob must be between 0 and 1, "
            f"got {domain.reference_slot_error_prob}",
        )


def _value(
    domain: Domain, place: Place, slot: str, value: object, *, reserved: tuple[int, ...] = ()
) -> Iterator[Fault]:
    if slot not in domain.slots:
        yield from _unknown(domain, place, [slot])
    elif not isinstance(value, str) or not value.strip() or value.splitlines() != [value]:
        yield Fault(place, f"{slot} must have one line of text, not blank, got {shown(value)}")
    elif not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
        yield Fault(place, f"{slot} must have text that UTF-8 can hold, got {shown(value)}")
    elif _RESERVED.get(fold(value)) not in (None, *reserved):
        yield Fault(place, f"{slot} must not have the reserved value {shown(value)}")


def _records(domain: Domain) -> Iterator[Fault]:
    if not domain.records:
        yield Fault(("records",), "the knowledge base is empty")
    for row, record in enumerate(domain.records):
        place = ("records", row)
        if not record:
            yield Fault(place, "it must have at least one value, got none")
        for slot, value in record.items():
            yield from _value(domain, place, slot, value)
            if slot in domain.special_slots:
                yield Fault(place, f"it must not hold the special slot {slot!r}")


def _goals(domain: Domain) -> Iterator[Fault]:
    if not domain.goals:
        yield Fault(("goals",), "there are no goals")
    for number, goal in enumerate(domain.goals):
        place = ("goals", number)
        if twice := repeated(goal.requests):
            yield Fault(place, f"it must request a slot once, got {twice} again")
        yield from _unknown(domain, place, goal.requests)
        for slot, value in goal.constraints.items():
            yield from _value(domain, place, slot, value, reserved=(DONT_CARE,))
        for slot in (*goal.constraints, *goal.requests):
            if slot in domain.special_slots:
                yield Fault(
                    place, f"it must not name {slot!r}: every goal requests the ticket as it is"
                )
        if both := [slot for slot in goal.requests if slot in goal.constraints]:
            yield Fault(place, f"it must not constrain and request the same slots {both}")


def _error_values(domain: Domain) -> Iterator[Fault]:
    for slot, values in domain.error_values.items():
        place = ("error_values", slot)
        if not values:
            yield Fault(place, f"{slot} must list at least one value, got none")
        yield from _unknown(domain, place, [slot])
        for value in values if slot in domain.slots else ():
            yield from _value(domain, (*place, value), slot, value)
        if slot in domain.special_slots:
            yield Fault(place, f"it must not list the special slot {slot!r}")


def repeated(names: Iterable[str]) -> list[str]:
    """Returns the names that occur more than once, in order of their second appearance."""
    seen: set[str] = set()
    twice: list[str] = []
    for name in names:
        if name in seen and name not in twice:
            twice.append(name)
        seen.add(name)
    return twice
