"""The parts of a domain as plain data: actions, goals and scripted policies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

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


def repeated(names: Iterable[str]) -> list[str]:
    """Returns the names that occur more than once, in order of their second appearance."""
    seen: set[str] = set()
    twice: list[str] = []
    for name in names:
        if name in seen and name not in twice:
            twice.append(name)
        seen.add(name)
    return twice
