"""A dialogue domain as plain data, and the checks that every domain passes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

from bbq_torchrl.domains.values import DONT_CARE, RESERVED_TEXT, fold
from bbq_torchrl.settings import PROBABILITY, WORDS, integers
from bbq_torchrl.utils.text import FaultsError, shown

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
"""The acts that the user simulator interprets; a domain may add others."""

ACTION_KINDS = ("act", "request", "inform", "multiple_choice")
"""The kinds of actions in their order: first those without a slot, then those with one."""

RANDOM_POLICY = "random"
"""The name of the random policy, which every domain has."""

PRIVILEGED_POLICY = "clairvoyant"
"""The name of the policy that reads the user's hidden goal, a reference for agents."""

MAX_TURN_WIDTH = 1_000
"""The largest width of the one-hot turn, which adds as many features to every observation."""

PolicyKind = Literal["script", "careful", "repair"]


@dataclass(frozen=True)
class Action:
    """One de-lexicalized action of the agent; the tracker fills in the value.

    Args:
        act: the dialogue act that the user hears.
        slot: the slot requested, informed or offered; ``None`` for a slotless act.

    Raises:
        ValueError: if the act cannot carry a slot.

    Examples:
        >>> str(Action("request", "moviename"))
        'request(moviename)'
    """

    act: str
    slot: str | None = None

    def __post_init__(self) -> None:
        if self.slot is not None and self.act not in ACTION_KINDS[1:]:
            raise ValueError(
                "only request, inform and multiple_choice carry a slot in an action, "
                f"got {str(self)!r}"
            )

    @property
    def kind(self) -> str:
        """``"act"`` for an act without a slot, else the act that carries the slot."""
        return "act" if self.slot is None else self.act

    def __str__(self) -> str:
        return self.act if self.slot is None else f"{self.act}({self.slot})"


@dataclass(frozen=True)
class Goal:
    """A user's goal: slots with required values, and slots whose value is requested.

    Every user also wants the ticket; it is not listed in ``requests``.

    Args:
        constraints: slot to value; every record meets the value ``"I do not care"``.
        requests: the slots whose value the user asks for.
    """

    constraints: Mapping[str, str]
    requests: tuple[str, ...] = ()


@dataclass(frozen=True)
class ScriptedPolicySpec:
    """A hand-written policy as data.

    Args:
        kind: ``"script"`` plays the actions ``steps`` in order, whatever the user says.
            ``"careful"`` requests the unfilled slots of ``steps``, answers the user's requests,
            offers the booking and ends. ``"repair"`` lets the user talk, requests the filled slots
            of ``steps`` again after a misunderstanding, answers, offers and ends.
        steps: action texts for a script, slot names for the other kinds.
    """

    kind: PolicyKind
    steps: tuple[str, ...]


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
        opening_slots: the slots informed in every first turn if the goal constrains them.
        turn_width: length of the one-hot turn feature.
        policies: scripted policies by name.
        reference_slot_error_prob: the slot error probability that makes the domain as difficult
            as the reference setting.
        records: the knowledge base; slot to value, sparse.
        goals: the users' goals, drawn uniformly.
        error_values: slot to the values that an error can substitute, drawn uniformly (a value
            listed twice is drawn twice as often).
        skipped: the parts of a corpus that a loader left out, as sentences for the reports.
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
    opening_slots: tuple[str, ...]
    turn_width: int
    policies: Mapping[str, ScriptedPolicySpec]
    reference_slot_error_prob: float
    records: tuple[Mapping[str, str], ...]
    goals: tuple[Goal, ...]
    error_values: Mapping[str, tuple[str, ...]]
    skipped: tuple[str, ...] = ()
    folder: Path | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if found := list(_faults(self)):
            raise DomainError(f"domain {shown(self.name)}", found)

    @property
    def special_slots(self) -> tuple[str, str]:
        """The ticket and the complete slot, which take reserved values only."""
        return (self.ticket_slot, self.complete_slot)

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


class Fault(NamedTuple):
    """One fault and its location.

    Attributes:
        field: a field of the domain.
        text: a sentence.
        entry: the index of a record or goal, or the slot of a list of values; ``None`` for the
            whole field.
        value: the value in a list of values.
    """

    field: str
    text: str
    entry: int | str | None = None
    value: str | None = None


class Source(NamedTuple):
    """The place that a field was read from.

    Attributes:
        name: the file's name; empty for a domain in memory.
        unit: the unit of an entry, such as ``"line"``.
        numbers: the number of each entry; ``None``: its index.
    """

    name: str
    unit: str = ""
    numbers: Sequence[int] | None = None


_IN_MEMORY = {"records": Source("", "record"), "goals": Source("", "goal")}


class DomainError(FaultsError):
    """An inconsistent domain.

    Args:
        subject: the domain.
        found: its faults, at least one.

    Attributes:
        found: the same, for callers that know the files.
    """

    def __init__(self, subject: str, found: Iterable[Fault]) -> None:
        self.found = tuple(found)
        super().__init__(subject, sentences(self.found, _IN_MEMORY))


def sentences(found: Iterable[Fault], sources: Mapping[str, Source], rest: str = "") -> list[str]:
    """Returns the faults as sentences, in the order of files and entries.

    Faults with the same text share one sentence: a slot that is unknown in a thousand records is
    one fault.

    Args:
        found: the faults.
        sources: the sources by field.
        rest: the file of all other fields.
    """
    places: dict[tuple[Source, str], list[int]] = {}
    for fault in found:
        source = sources.get(fault.field, Source(rest))
        numbers = places.setdefault((source._replace(numbers=None), fault.text), [])
        if isinstance(fault.entry, int):
            number = source.numbers[fault.entry] if source.numbers else fault.entry
            numbers += [number] if number not in numbers[-1:] else []
    files = list(dict.fromkeys(source.name for source, _ in places))
    in_order = sorted(places.items(), key=lambda item: (files.index(item[0][0].name), item[1][:1]))
    written = []
    for (source, text), numbers in in_order:
        where = [source.name] if source.name else []
        if numbers:
            some = ", ".join(map(str, numbers[:3]))
            more = f" and {len(numbers) - 3} more" if len(numbers) > 3 else ""
            where.append(f"{source.unit}{'s' if len(numbers) > 1 else ''} {some}{more}")
        written.append(": ".join([", ".join(where), text] if where else [text]))
    return written


_SETTINGS = {
    "name": WORDS,
    "turn_width": integers(1, MAX_TURN_WIDTH),
    "reference_slot_error_prob": PROBABILITY,
}
_RESERVED = {fold(text): key for key, text in RESERVED_TEXT.items()}


def _faults(domain: Domain) -> Iterator[Fault]:
    """Yields the faults of a domain."""
    for key, text in (*_fields(domain), *_names(domain), *_actions(domain)):
        yield Fault(key, text)
    for name, policy in domain.policies.items():
        yield from (Fault("policies", text) for text in _policy(domain, name, policy))
    for row, record in enumerate(domain.records):
        yield from (Fault("records", text, row) for text in _record(domain, record))
    for number, goal in enumerate(domain.goals):
        yield from (Fault("goals", text, number) for text in _goal(domain, goal))
    for slot, values in domain.error_values.items():
        yield from (Fault("error_values", text, slot) for text in _list(domain, slot, values))
        for value in values if slot in domain.slots else ():
            texts = _value(domain, slot, value)
            yield from (Fault("error_values", text, slot, value) for text in texts)


def _fields(domain: Domain) -> Iterator[tuple[str, str]]:
    """Yields the faults of fields as a whole, and of fields that contradict each other."""
    for key, allowed in _SETTINGS.items():
        if text := allowed.fault(key, getattr(domain, key)):
            yield key, text
    for key in ("records", "goals"):
        if not getattr(domain, key):
            yield key, f"{key} must have at least one entry, got none"
    if both := {*domain.extension_order} & {*domain.essential}:
        yield "extension_order", f"extension_order must have no essential slot, got {sorted(both)}"
    known = {action.slot for action in domain.actions if action.kind in ACTION_KINDS[2:]}
    known |= {*domain.error_values, *(slot for record in domain.records for slot in record)}
    if known <= {*domain.free_slots}:
        yield "free_slots", "free_slots must leave a slot that constrains the records, got all"
    if (ticket := domain.ticket_slot) == domain.complete_slot:
        yield "complete_slot", f"complete_slot must not be the ticket_slot, got {ticket!r} for both"
    for key in ("ticket_slot", "complete_slot"):
        for group in ("essential", "free_slots"):
            if (slot := getattr(domain, key)) not in (members := getattr(domain, group)):
                yield key, f"{key} must be among {group}, {slot!r} is not in {list(members)}"
    if wrong := {*domain.opening_slots} & {*domain.special_slots}:
        yield "opening_slots", f"opening_slots must be ordinary slots, got {sorted(wrong)}"


def _names(domain: Domain) -> Iterator[tuple[str, str]]:
    """Yields the faults of lists of names."""
    lists = ("acts", "slots", "essential", "extension_order", "free_slots", "opening_slots")
    for key in (*lists, "actions"):
        names = list(map(str, getattr(domain, key)))
        if twice := _repeated(names):
            yield key, f"{key} must be distinct, got {twice} more than once"
        if key not in ("acts", "slots", "actions"):
            yield from ((key, text) for text in _unknown(domain, names, f"{key} names "))
    for act in domain.acts:
        if not act.isidentifier():
            yield "acts", f"acts must be identifiers, got {shown(act)}"
    if missing := [act for act in REQUIRED_ACTS if act not in domain.acts]:
        yield "acts", f"acts must contain {list(REQUIRED_ACTS)}, {missing} are missing"
    for slot in domain.slots:
        # "all" and the turn's "0", "1", ... are names of features.
        if not re.fullmatch(r"\w+", slot) or slot == "all" or slot.isdigit():
            text = f"slots must be letters, digits or _, no number, not 'all', got {shown(slot)}"
            yield "slots", text


def _actions(domain: Domain) -> Iterator[tuple[str, str]]:
    names = domain.action_names
    kinds = [ACTION_KINDS.index(action.kind) for action in domain.actions]
    if kinds != sorted(kinds):
        order = "slotless acts, then requests, informs and multiple choices"
        yield "actions", f"actions must be {order}, got {', '.join(names)}"
    if (offer := f"inform({domain.complete_slot})") not in names:
        yield "actions", f"actions must contain {offer}: without it nothing can be booked"
    if not {"thanks", "closing"} & {*names}:
        yield "actions", "actions must contain thanks or closing: no dialogue succeeds otherwise"
    for action in domain.actions:
        yield from (("actions", f"action {action} {text}") for text in _action(domain, action))


def _action(domain: Domain, action: Action) -> Iterator[str]:
    if action.act not in domain.acts:
        yield f"has the unknown act {action.act!r}; the acts are {', '.join(domain.acts)}"
    if action.slot is not None:
        yield from _unknown(domain, [action.slot], "names ")
    elif action.act in ACTION_KINDS[1:]:
        yield f"needs a slot, written {action.act}(slot)"
    if action.kind in ("request", "multiple_choice") and action.slot in domain.special_slots:
        yield f"has no effect: no user constrains {action.slot}"


def _policy(domain: Domain, name: str, policy: ScriptedPolicySpec) -> Iterator[str]:
    key = f"policies.{name}"
    if name in ("", RANDOM_POLICY, PRIVILEGED_POLICY):
        reserved = f"{RANDOM_POLICY} and {PRIVILEGED_POLICY}"
        yield f"policies must have names other than {reserved}, not empty, got {name!r}"
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
    if twice := _repeated(goal.requests):
        yield f"it must request a slot once, got {twice} again"
    yield from _unknown(domain, goal.requests)
    for slot, value in goal.constraints.items():
        yield from _value(domain, slot, value, reserved=(DONT_CARE,))
    for slot in (*goal.constraints, *goal.requests):
        if slot in domain.special_slots:
            yield f"it must not name {slot!r}: every goal requests the ticket anyway"
    if both := [slot for slot in goal.requests if slot in goal.constraints]:
        yield f"it must not constrain and request the same slots {both}"


def _list(domain: Domain, slot: str, values: tuple[str, ...]) -> Iterator[str]:
    if not values:
        yield f"{slot} must list at least one value, got none"
    yield from _unknown(domain, [slot])
    if slot in domain.special_slots:
        yield f"it must not list the special slot {slot!r}"


def _unknown(domain: Domain, slots: Iterable[str], names: str = "it names ") -> Iterator[str]:
    for slot in slots:
        if slot not in domain.slots:
            known = ", ".join(domain.slots)
            yield f"{names}the unknown slot {shown(slot)}; the slots are {known}"


def _repeated(names: Iterable[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]
