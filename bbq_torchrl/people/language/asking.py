"""When a system asks again, and what becomes of the answer: one rule for people and simulations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from bbq_torchrl.domains.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.people.language.endpoint import EndpointUnderstander
    from bbq_torchrl.people.language.frames import Understood
    from bbq_torchrl.people.language.understand import Understander

MOST_ASKS = 2
"""How often a system asks again in a row: better a mistake, which can be corrected, than no end."""


@dataclass(frozen=True)
class Asking:
    """What a system has asked again since it last acted; at first nothing.

    Attributes:
        times: how often.
        waiting: what was understood beside what it asked about.
        slot: what it asked about; empty where it asked for other words.
        choices: between which values of it; none where it knew none.

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
        ears: Understander | EndpointUnderstander,
        understood: Understood,
        below: float | None = None,
    ) -> bool:
        """Returns whether the system asks again rather than act on what it understood.

        Args:
            ears: who understood.
            understood: what.
            below: the confidence below which it asks; where a name is unclear it asks at any.
                ``None`` for what is usual to who understood, 0 for never.
        """
        if self.times >= MOST_ASKS or below == 0:
            return False
        if below is None:
            return ears.asks(understood)
        return understood.confidence < below or bool(understood.unclear)

    def again(self, understood: Understood | None) -> Asking:
        """Returns what there is after it has asked again.

        Args:
            understood: its first unclear name is asked about; where there is none, or nothing
                could be read (``None``), the system asks for other words.
        """
        if understood is None or not understood.unclear:
            return replace(self, times=self.times + 1)
        unclear = understood.unclear[0]
        waiting = self.joined(understood.frame)
        return Asking(self.times + 1, waiting, unclear.slot, unclear.candidates)

    def question(self, said: Frame | None) -> Frame | None:
        """Returns in the light of what the next text is read.

        Args:
            said: the agent's last act; ``None`` before its first.
        """
        if self.choices:
            return Frame("multiple_choice", {}, (self.slot,), self.choices)
        return Frame("request", {}, (self.slot,)) if self.slot else said

    def joined(self, frame: Frame) -> Frame:
        """Returns an act with what was understood of the texts before, which were asked about."""
        is_of_values = frame.act in ("inform", "request", "confirm_question")
        if self.waiting is None or not (frame.informs or frame.requests or is_of_values):
            return frame  # "No, goodbye."
        requests = tuple(dict.fromkeys((*self.waiting.requests, *frame.requests)))
        informs = {**self.waiting.informs, **frame.informs}
        return Frame("request" if requests else frame.act, informs, requests)


def repeated(meant: Frame, asked: Sequence[str]) -> Frame:
    """Returns what a simulated user says who is asked again.

    Args:
        meant: what it has said.
        asked: the slots that it is asked about: it says them alone, where it has said any of them.
            Otherwise it says all of it once more.
    """
    informs = {slot: meant.informs[slot] for slot in asked if slot in meant.informs}
    return Frame("inform", informs) if informs else meant
