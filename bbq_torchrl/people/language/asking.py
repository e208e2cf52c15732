"""Asking again: when to ask, and how to merge the answer with what was understood before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from bbq_torchrl.domains.frames import Frame

OPENING = Frame("none")
"""Placeholder for the agent's last act before it has acted."""

YES = ("thanks", "confirm_answer")
"""The acts by which a person takes what the agent offers or proposes."""

FOREIGN = Frame("foreign")
"""Placeholder for the meaning of an out-of-domain sentence."""


@dataclass(frozen=True)
class Unclear:
    """Words that name an unknown, an ambiguous or a rejected value of a slot.

    Args:
        slot: the slot they seem to be about.
        text: the words.
        candidates: the values that fit equally well; empty for an unknown value.
        is_denied: whether the person rejects the value that ``text`` names.
    """

    slot: str
    text: str
    candidates: tuple[str, ...] = ()
    is_denied: bool = False


@dataclass(frozen=True)
class Understood:
    """The understanding of a sentence.

    Args:
        frame: the act with values of the domain.
        confidence: the probability that the frame is right.
        unclear: words left out of the frame, which the system should ask about.
        source: the nlu that understood it: ``"own"`` or ``"endpoint"``.
        takes: the probability that it takes what the agent offers or proposes, whatever else it
            says.
    """

    frame: Frame
    confidence: float
    unclear: tuple[Unclear, ...] = ()
    source: str = "own"
    takes: float = 0.0


def asked_slot(question: Frame) -> str | None:
    """Returns the first slot that an agent's act asks for, if any."""
    return question.requests[0] if question.requests else None


MAX_ASKS = 2
"""The most clarifications in a row: a mistake can be corrected, endless asking cannot."""


class Nlu(Protocol):
    """Understands sentences."""

    def __call__(self, text: str, question: Frame | None = None) -> Understood:
        """Returns the meaning of a text, given the agent's last act."""

    def asks(self, understood: Understood) -> bool:
        """Returns whether a sentence was understood too poorly to act on."""


@dataclass(frozen=True)
class Asking:
    """The clarification questions since the system last acted; initially empty.

    Attributes:
        times: the number of questions.
        waiting: the act understood so far, without the unclear value.
        slot: the slot it asked about; empty if it asked the user to rephrase.
        choices: the candidate values of the slot, if any.

    Examples:
        >>> from bbq_torchrl.people.language import Unclear, Understood
        >>> unclear = Unclear("moviename", "godzilla", ("godzilla minus one", "godzilla x kong"))
        >>> two = Understood(Frame("inform", {"numberofpeople": "2"}), 0.9, (unclear,))
        >>> asking = Asking().again(two)
        >>> str(asking.question(None))
        'multiple_choice(moviename=godzilla minus one, moviename=godzilla x kong)'
        >>> str(asking.joined(Frame("inform", {"moviename": "godzilla minus one"})))
        'inform(numberofpeople=2, moviename=godzilla minus one)'
    """

    times: int = 0
    waiting: Frame | None = None
    slot: str = ""
    choices: tuple[str, ...] = ()

    def asks(
        self,
        nlu: Nlu,
        understood: Understood,
        below: float | None = None,
    ) -> bool:
        """Returns whether the system asks again instead of acting on what it understood.

        Args:
            nlu: the nlu that understood the text.
            understood: the result of the nlu.
            below: the confidence below which it asks; it always asks about an unclear name.
                ``None`` for the threshold of the nlu, 0 for never.
        """
        if self.times >= MAX_ASKS or below == 0:
            return False
        if below is None:
            return nlu.asks(understood)
        return understood.confidence < below or bool(understood.unclear)

    def again(self, understood: Understood | None) -> Asking:
        """Returns the questions after the system has asked again.

        Args:
            understood: the system asks about its first unclear name. Without one, and for a text
                that could not be read (``None``), it asks the user to rephrase.
        """
        if understood is None or not understood.unclear:
            return replace(self, times=self.times + 1)
        unclear = understood.unclear[0]
        waiting = self.joined(understood.frame)
        return Asking(self.times + 1, waiting, unclear.slot, unclear.candidates)

    def question(self, said: Frame | None) -> Frame | None:
        """Returns the act that the next text answers.

        Args:
            said: the agent's last act; ``None`` before its first.
        """
        if self.choices:
            return Frame("multiple_choice", {}, (self.slot,), self.choices)
        return Frame("request", {}, (self.slot,)) if self.slot else said

    def joined(self, frame: Frame) -> Frame:
        """Returns an act merged with what was understood from the previous texts."""
        is_of_values = frame.act in ("inform", "request", "confirm_question")
        if self.waiting is None or not (frame.informs or frame.requests or is_of_values):
            return frame  # "No, goodbye."
        requests = tuple(dict.fromkeys((*self.waiting.requests, *frame.requests)))
        informs = {**self.waiting.informs, **frame.informs}
        return Frame("request" if requests else frame.act, informs, requests)


def repeated(meant: Frame, asked: Sequence[str]) -> Frame:
    """Returns the act of a simulated user who is asked again.

    Args:
        meant: the user's act.
        asked: the slots asked about. The user repeats only these if the act informs any of them,
            and otherwise the whole act.
    """
    informs = {slot: meant.informs[slot] for slot in asked if slot in meant.informs}
    return Frame("inform", informs) if informs else meant
