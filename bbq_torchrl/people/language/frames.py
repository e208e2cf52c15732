"""What was understood of a sentence, and what was not."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.domains.frames import Frame

OPENING = Frame("none")
"""What stands for the agent's last act where it has said nothing yet."""


@dataclass(frozen=True)
class Unclear:
    """Words that name a value of a slot which is not known, or several.

    Args:
        slot: what they seem to be about.
        text: the words.
        candidates: the values that they may mean equally well; none for an unknown one.
    """

    slot: str
    text: str
    candidates: tuple[str, ...] = ()


@dataclass(frozen=True)
class Understood:
    """What was understood of a sentence.

    Args:
        frame: the act with values of the domain.
        confidence: the probability that the frame is right.
        unclear: words that are not in the frame, and that the system should ask about.
        source: who understood: ``"own"`` or ``"endpoint"``.
    """

    frame: Frame
    confidence: float
    unclear: tuple[Unclear, ...] = ()
    source: str = "own"


def asked_slot(question: Frame) -> str | None:
    """Returns the slot that an agent's act asks for, of several the first."""
    return question.requests[0] if question.requests else None
