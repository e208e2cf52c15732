"""A dialogue domain as plain data, and the checks that every domain passes."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from bbq_torchrl.domains.faults import DomainError, Fault
from bbq_torchrl.domains.specification import (
    ACTION_KINDS,
    PRIVILEGED_POLICY,
    RANDOM_POLICY,
    REQUIRED_ACTS,
    repeated,
)
from bbq_torchrl.domains.values import DONT_CARE, RESERVED_TEXT, fold
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from bbq_torchrl.domains.faults import Place
    from bbq_torchrl.domains.specification import Action, Goal, ScriptedPolicySpec

MAX_TURN_WIDTH = 1_000
"""The largest width of the one-hot turn, which adds as many features to every observation."""

_RESERVED = {fold(text): key for key, text in RESERVED_TEXT.items()}


@dataclass(frozen=True)
class Domain:
    """A dialogue domain: everything the simulator needs to know, as data.

    Every field is checked on construction, so a ``Domain`` that exists is consistent.

    Args:
        name: the domain's name in configurations and results.
        acts: dialogue acts; must contain :data:`REQUIRED_ACTS`.
        slots: slot names; their order is the order of all slot-wise features.
        actions: the agent's actions: slotless acts, then requests, informs, multiple choices.
        essential: slots that are active from the first round on.
        extension_order: the slots that domain extension adds, in order.
        free_slots: slots that never constrain the records, such as the number of people.
        ticket_slot: the slot that every user requests: the booking itself.
        complete_slot: the slot whose inform offers a booking.
        opening_slot: the slot or slots informed in every first turn if the goal constrains them,
            or ``None``.
        turn_width: length of the one-hot turn feature.
        policies: scripted policies by name.
        reference_slot_error_prob: the slot error probability that makes the domain as difficult
            as the reference setting.
        records: the knowledge base; slot to value, sparse.
        goals: the users' goals, drawn uniformly.
        error_values: slot to the values that an error can substitute, drawn uniformly (a value
            listed twice is drawn twice as often).
        skipped: the parts of a corpus that a loader left out, as sentences for the reports.
        doubts: likely typing errors of a corpus that a loader kept, as sentences.
        folder: the folder that the domain was loaded from, which may also have phrases and measured
            errors; ``None`` for a domain built in memory. Comparisons ignore it.

    Raises:
        DomainError: a ``ValueError``, if any of the above is violated. It lists all faults, each
            with key, value and what is allowed.
    """

    name: str
    acts: tuple[str, ...]
    slots: tuple[str, ...]
    actions: tuple[Action, ...]
    essential: tuple[str, ...]
    extension_order: tuple[str, ...]
    free_slots: tuple[str, ...]
    ticket_slot: str
    complete_slot: str
    opening_slot: str | tuple[str, ...] | None
    turn_width: int
    policies: Mapping[str, ScriptedPolicySpec]
    reference_slot_error_prob: float
    records: tuple[Mapping[str, str], ...]
    goals: tuple[Goal, ...]
    error_values: Mapping[str, tuple[str, ...]]
    skipped: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    folder: Path | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        found = [Fault(place, text) for place, texts in _faults(self) for text in texts]
        if found:
            raise DomainError(f"domain {shown(self.name)}", found)

    @property
    def special_slots(self) -> tuple[str, str]:
        """The ticket and the complete slot, which take reserved values only."""
        return (self.ticket_slot, self.complete_slot)

    @property
    def opening_slots(self) -> tuple[str, ...]:
        """The slots informed in every first turn if the goal constrains them."""
        opening = self.opening_slot
        return opening if isinstance(opening, tuple) else () if opening is None else (opening,)

    @cached_property
    def action_names(self) -> tuple[str, ...]:
        """The actions as text, in order: ``("greeting", ..., "request(moviename)", ...)``."""
        return tuple(str(action) for action in self.actions)

    def action_index(self, name: str) -> int:
        """Returns the index of the action with the text ``name``.

        Raises:
            ValueError: if the domain has no such action.
        """
        if name not in self.action_names:
            raise ValueError(
                f"{name!r} is not an action of domain {self.name!r}, which has "
                f"{', '.join(self.action_names)}"
            )
        return self.action_names.index(name)


def _faults(domain: Domain) -> Iterator[tuple[Place, Iterable[str]]]:
    """Yields the faults of each part of a domain."""
    for key, text in _fields(domain):
        yield (key,), [text]
    yield ("acts",), _acts(domain)
    yield ("slots",), _slots(domain)
    yield ("opening_slot",), _opening_slot(domain)
    yield ("actions",), _actions(domain)
    for key in ("acts", "slots", "essential", "extension_order", "free_slots"):
        yield (key,), _names(domain, key)
    for key in ("ticket_slot", "complete_slot"):
        yield (key,), _special_slot(domain, key)
    for action in domain.actions:
        yield ("actions", action.kind), _action(domain, action)
    for name, policy in domain.policies.items():
        yield ("policies", name), _policy(domain, name, policy)
    for row, record in enumerate(domain.records):
        yield ("records", row), _record(domain, record)
    for number, goal in enumerate(domain.goals):
        yield ("goals", number), _goal(domain, goal)
    for slot, values in domain.error_values.items():
        yield ("error_values", slot), _error_values(domain, slot, values)
        for value in values if slot in domain.slots else ():
            yield ("error_values", slot, value), _value(domain, slot, value)


def _fields(domain: Domain) -> Iterator[tuple[str, str]]:
    """Yields the faults of a field as a whole, or of fields that contradict each other."""
    if not domain.name:
        yield "name", "name of a domain must not be empty"
    if both := [slot for slot in domain.extension_order if slot in domain.essential]:
        text = f"extension_order must not contain essential slots, got {both} in both"
        yield "extension_order", text
    known = {action.slot for action in domain.actions if action.kind in ACTION_KINDS[2:]}
    known |= {*domain.error_values, *(slot for record in domain.records for slot in record)}
    if known <= {*domain.free_slots}:
        text = "free_slots must leave a slot that constrains the records, got all that have values"
        yield "free_slots", text
    if (ticket := domain.ticket_slot) == domain.complete_slot:
        text = f"ticket_slot and complete_slot must differ, got {ticket!r} for both"
        yield "complete_slot", text
    if not 1 <= (width := domain.turn_width) <= MAX_TURN_WIDTH:
        text = f"turn_width must be between 1 and {MAX_TURN_WIDTH}, got {shown(width)}"
        yield "turn_width", text
    key, chance = "reference_slot_error_prob", domain.reference_slot_error_prob
    if not 0.0 <= chance <= 1.0:
        yield key, f"{key} must be between 0 and 1, got {chance}"
    if not domain.records:
        yield "records", "the knowledge base is empty"
    if not domain.goals:
        yield "goals", "the list of goals is empty"


def _names(domain: Domain, key: str) -> Iterator[str]:
    names: tuple[str, ...] = getattr(domain, key)
    if twice := repeated(names):
        yield f"{key} must be distinct, got {twice} more than once"
    if key not in ("acts", "slots"):
        yield from _unknown(domain, names, f"{key} names ")


def _unknown(domain: Domain, slots: Iterable[str], names: str = "it names ") -> Iterator[str]:
    for slot in slots:
        if slot not in domain.slots:
            known = ", ".join(domain.slots)
            yield f"{names}the unknown slot {shown(slot)}; the slots are {known}"


def _acts(domain: Domain) -> Iterator[str]:
    for act in domain.acts:
        if not act.isidentifier():
            yield f"acts must be identifiers, got {shown(act)}"
    if missing := [act for act in REQUIRED_ACTS if act not in domain.acts]:
        yield f"acts must contain {list(REQUIRED_ACTS)}, {missing} are missing"


def _slots(domain: Domain) -> Iterator[str]:
    for slot in domain.slots:
        # "all" and the turn's "0", "1", ... are names of features.
        if not re.fullmatch(r"\w+", slot) or slot == "all" or slot.isdigit():
            yield (
                f"slots must consist of letters, digits and underscores, not of digits alone, and "
                f"must not be 'all', got {shown(slot)}"
            )


def _special_slot(domain: Domain, key: str) -> Iterator[str]:
    slot: str = getattr(domain, key)
    yield from _unknown(domain, [slot], f"{key} names ")
    for group in ("essential", "free_slots"):
        members: tuple[str, ...] = getattr(domain, group)
        if slot in domain.slots and slot not in members:
            yield f"{key} must be among {group}, {slot!r} is not in {list(members)}"


def _opening_slot(domain: Domain) -> Iterator[str]:
    yield from _unknown(domain, domain.opening_slots, "opening_slot names ")
    if twice := repeated(domain.opening_slots):
        yield f"opening_slot must name a slot once, got {twice} again"
    for slot in domain.opening_slots:
        if slot in domain.special_slots:
            yield f"opening_slot must not be the ticket or the complete slot, got {slot!r}"


def _actions(domain: Domain) -> Iterator[str]:
    if twice := repeated(domain.action_names):
        yield f"actions must be distinct, got {twice} more than once"
    kinds = [ACTION_KINDS.index(action.kind) for action in domain.actions]
    if kinds != sorted(kinds):
        yield (
            f"actions must be slotless acts, then requests, informs and multiple choices, "
            f"got {', '.join(domain.action_names)}"
        )
    offer = f"inform({domain.complete_slot})"
    if offer not in domain.action_names:
        yield f"actions must contain {offer}: without it nothing can be booked"
    if not {"thanks", "closing"} & set(domain.action_names):
        yield "actions must contain thanks or closing: without them no dialogue succeeds"


def _action(domain: Domain, action: Action) -> Iterator[str]:
    if action.act not in domain.acts:
        acts = ", ".join(domain.acts)
        yield f"action {action} has the unknown act {action.act!r}; the acts are {acts}"
    if action.slot is not None:
        yield from _unknown(domain, [action.slot], f"action {action} names ")
    elif action.act in ACTION_KINDS[1:]:
        yield f"action {action} needs a slot, written {action.act}(slot)"
    if action.kind in ("request", "multiple_choice") and action.slot in domain.special_slots:
        yield f"action {action} has no effect: no user constrains {action.slot}"


def _policy(domain: Domain, name: str, policy: ScriptedPolicySpec) -> Iterator[str]:
    key = f"policies.{name}"
    if name in ("", RANDOM_POLICY, PRIVILEGED_POLICY):
        yield (
            f"policies must not have an empty name or the name {RANDOM_POLICY} or "
            f"{PRIVILEGED_POLICY}, got {name!r}"
        )
    if not policy.steps:
        yield f"{key} must have at least one step, got none"
    requests = [f"request({slot})" for slot in policy.steps if slot in domain.slots]
    ending = (f"inform({domain.complete_slot})", "thanks")
    needed = {
        "script": policy.steps,
        "careful": (*requests, *ending),
        "repair": (*requests, f"inform({domain.ticket_slot})", "confirm_answer", *ending),
    }
    if policy.kind not in needed:
        yield f"{key} must be of kind {', '.join(needed)}, got {shown(policy.kind)}"
    elif policy.kind != "script":
        yield from _unknown(domain, policy.steps, f"{key} names ")
    for action in needed.get(policy.kind, ()):
        if action not in domain.action_names:
            names = ", ".join(domain.action_names)
            yield f"{key} needs the action {shown(action)}, which is not among {names}"


def _value(
    domain: Domain, slot: str, value: object, *, reserved: tuple[int, ...] = ()
) -> Iterator[str]:
    if slot not in domain.slots:
        yield from _unknown(domain, [slot])
    elif not isinstance(value, str) or not value.strip() or value.splitlines() != [value]:
        yield f"{slot} must be one line of text, not blank, got {shown(value)}"
    elif not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
        yield f"{slot} must be text that UTF-8 can encode, got {shown(value)}"
    elif _RESERVED.get(fold(value)) not in (None, *reserved):
        yield f"{slot} must not be the reserved value {shown(value)}"


def _record(domain: Domain, record: Mapping[str, str]) -> Iterator[str]:
    if not record:
        yield "it must have at least one value, got none"
    for slot, value in record.items():
        yield from _value(domain, slot, value)
        if slot in domain.special_slots:
            yield f"it must not contain the special slot {slot!r}"


def _goal(domain: Domain, goal: Goal) -> Iterator[str]:
    if twice := repeated(goal.requests):
        yield f"it must request a slot once, got {twice} again"
    yield from _unknown(domain, goal.requests)
    for slot, value in goal.constraints.items():
        yield from _value(domain, slot, value, reserved=(DONT_CARE,))
    for slot in (*goal.constraints, *goal.requests):
        if slot in domain.special_slots:
            yield f"it must not name {slot!r}: every goal requests the ticket anyway"
    if both := [slot for slot in goal.requests if slot in goal.constraints]:
        yield f"it must not constrain and request the same slots {both}"


def _error_values(domain: Domain, slot: str, values: tuple[str, ...]) -> Iterator[str]:
    if not values:
        yield f"{slot} must list at least one value, got none"
    yield from _unknown(domain, [slot])
    if slot in domain.special_slots:
        yield f"it must not list the special slot {slot!r}"
