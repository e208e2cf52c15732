"""What a dialogue is about, as plain data: acts, slots, agent actions, records and goals."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from bbq_torchrl.domains.validate import ACTION_KINDS, check_domain

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

PolicyKind = Literal["script", "careful", "repair"]


@dataclass(frozen=True)
class Action:
    """One de-lexicalized action of the agent; the tracker fills the value in.

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
    """What one user wants: slots with the values they must have, and slots to be told.

    Every user also wants the ticket; it is not listed in ``requests``.

    Args:
        constraints: slot to value; ``"I do not care"`` is a value that every record meets.
        requests: slots whose value the user wants to hear.
    """

    constraints: Mapping[str, str]
    requests: tuple[str, ...] = ()


@dataclass(frozen=True)
class ScriptedPolicySpec:
    """A hand-written policy as data.

    Args:
        kind: ``"script"`` plays ``steps``, which are actions, in order, whatever the user says.
            ``"careful"`` requests those slots of ``steps`` that are unfilled, answers the user's
            requests, offers the booking and ends. ``"repair"`` lets the user talk, requests the
            filled slots of ``steps`` again where it was misunderstood, answers, offers and ends.
        steps: action texts for a script, slot names for the other kinds.
    """

    kind: PolicyKind
    steps: tuple[str, ...]


@dataclass(frozen=True)
class Domain:
    """A domain of dialogues: everything the simulator needs to know, none of it code.

    Every field is checked on construction, so a ``Domain`` that exists is consistent.

    Args:
        name: what the domain is called in configurations and results.
        acts: dialogue acts; must contain :data:`REQUIRED_ACTS`.
        slots: slot names; their order is the order of all slot-wise features.
        actions: the agent's actions: slotless acts, then requests, informs, multiple choices.
        essential: slots that are active from the first round on.
        extension_order: the slots that domain extension adds, first to last.
        free_slots: slots that never constrain the records (the number of people, say).
        ticket_slot: the slot every user requests: what is booked.
        complete_slot: the slot whose inform offers a booking.
        opening_slot: the slot, or slots, informed in every first turn if the goal constrains them;
            ``None`` for none.
        turn_width: length of the one-hot turn feature.
        policies: scripted policies by name.
        reference_slot_error_prob: the slot error probability that makes the domain as difficult
            as the reference setting.
        records: the knowledge base; slot to value, sparse.
        goals: the users' goals, drawn uniformly.
        error_values: slot to the values that an error can put in its place, drawn uniformly
            (a value listed twice is drawn twice as often).
        skipped: what a loader left out of a corpus, a sentence each; for whoever reads results.
        doubts: what a loader takes for slips of a corpus and leaves as it is, a sentence each.
        folder: where it was loaded from, with phrases and measured errors beside it; ``None`` for
            a domain of no folder. Where a domain lies makes it no other one.

    Raises:
        DomainError: a ``ValueError``, if anything above does not hold; it has every fault, and
            names key, value and what is allowed.
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
        check_domain(self)

    @property
    def special_slots(self) -> tuple[str, str]:
        """The ticket and the complete slot: they take reserved values only."""
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
        """Returns the index of the action that is written ``name``.

        Raises:
            ValueError: if the domain has no such action.
        """
        if name not in self.action_names:
            raise ValueError(
                f"{name!r} is no action of domain {self.name!r}, which has "
                f"{', '.join(self.action_names)}"
            )
        return self.action_names.index(name)
