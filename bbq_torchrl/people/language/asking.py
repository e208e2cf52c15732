"""Asking again: when a system asks, and how it joins the answer to what it understood before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from bbq_torchrl.domains.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence

OPENING = Frame("none")
"""Placeholder for the agent's last act before it has acted."""

FOREIGN = Frame("foreign")
"""Placeholder for what the domain cannot mean."""


@dataclass(frozen=True)
class Unclear:
    """Words that name a value of a slot which is not known, or several, or not what is wanted.

    Args:
        slot: what they seem to be about.
        text: the words.
        candidates: the values that they may mean equally well; none for an unknown one.
        is_denied: whether the person wants anything but this value: ``text`` names it.
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


MAX_ASKS = 2
"""The most times to ask again in a row: a mistake can be corrected, endless asking cannot."""


class Nlu(Protocol):
    """Understands sentences."""

    def __call__(self, text: str, question: Frame | None = None) -> Understood:
        """Returns the meaning of a text in the light of the agent's last act."""

    def asks(self, understood: Understood) -> bool:
        """Returns whether a sentence was understood too badly to act on it."""


@dataclass(frozen=True)
class Asking:
    """The questions that a system has asked again since it last acted; at first none.

    Attributes:
        times: how often.
        waiting: what was understood apart from what it asked about.
        slot: what it asked about; empty where it asked for other words.
        choices: between which values of it; none where it knew none.
        is_check: whether it asked if ``waiting`` is right.

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
    is_check: bool = False

    def asks(
        self,
        nlu: Nlu,
        understood: Understood,
        below: float | None = None,
    ) -> bool:
        """Returns whether the system asks again rather than act on what it understood.

        Args:
            nlu: who understood.
            understood: what.
            below: the confidence below which it asks; where a name is unclear it asks at any.
                ``None`` for what is usual to who understood, 0 for never.
        """
        if self.times >= MAX_ASKS or below == 0:
            return False
        if below is None:
            return nlu.asks(understood)
        return understood.confidence < below or bool(understood.unclear)

    def again(self, understood: Understood | None) -> Asking:
        """Returns the questions after it has asked again.

        Args:
            understood: the system asks about its first unclear name. Without one, and for a text
                that could not be read (``None``), it asks for other words.
        """
        if understood is None or not understood.unclear:
            return replace(self, times=self.times + 1)
        unclear = understood.unclear[0]
        waiting = self.joined(understood.frame)
        return Asking(self.times + 1, waiting, unclear.slot, unclear.candidates)

    def checking(self, understood: Understood) -> Asking:
        """Returns the questions after the system has asked whether it understood a text rightly."""
        return Asking(self.times + 1, self.joined(understood.frame), is_check=True)

    def question(self, said: Frame | None) -> Frame | None:
        """Returns the act in whose light the next text is read.

        Args:
            said: the agent's last act; ``None`` before its first.
        """
        if self.is_check:
            return Frame("confirm_question")
        if self.choices:
            return Frame("multiple_choice", {}, (self.slot,), self.choices)
        return Frame("request", {}, (self.slot,)) if self.slot else said

    def joined(self, frame: Frame) -> Frame:
        """Returns an act with what was understood of the texts before, which were asked about."""
        is_of_values = frame.act in ("inform", "request", "confirm_question")
        if self.waiting is None or not (frame.informs or frame.requests or is_of_values):
            return frame  # "No, goodbye."
        act = "inform" if self.is_check and frame.act == "deny" else frame.act  # "No, at 7."
        requests = tuple(dict.fromkeys((*self.waiting.requests, *frame.requests)))
        informs = {**self.waiting.informs, **frame.informs}
        return Frame("request" if requests else act, informs, requests)


def repeated(meant: Frame, asked: Sequence[str]) -> Frame:
    """Returns the act of a simulated user who is asked again.

    Args:
        meant: what it has said.
        asked: the slots that it is asked about: it says them alone, where it has said any of them.
            Otherwise it says all of it once more.
    """
    informs = {slot: meant.informs[slot] for slot in asked if slot in meant.informs}
    return Frame("inform", informs) if informs else meant
