"""Dialogue acts of users and agents, as text and as the simulator's ids."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bbq_torchrl.domains.values import (
    AVAILABLE,
    DONT_CARE,
    NO_MATCH,
    NONE,
    RESERVED_TEXT,
    fold,
    value_ids,
)
from bbq_torchrl.settings import check, one_of
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.domains.domain import Domain
    from bbq_torchrl.domains.tensors import DomainTensors


ANY = RESERVED_TEXT[DONT_CARE]
"""The value of a slot that the speaker does not care about."""

NO_MATCH_TEXT, AVAILABLE_TEXT = RESERVED_TEXT[NO_MATCH], RESERVED_TEXT[AVAILABLE]
"""The agent's values if no record matches, and if a booking is possible."""

_PART = re.compile(r"(?P<act>[A-Za-z_]\w*)(?:\((?P<content>[^()]*)\))?")
_FRAME = re.compile(r"[A-Za-z_]\w*(\([^()]*\))?(\s+[A-Za-z_]\w*(\([^()]*\))?)*")


@dataclass(frozen=True)
class Frame:
    """A dialogue act of the user or the agent.

    Args:
        act: one of the domain's acts.
        informs: slot to value, in the domain's spelling; :data:`ANY` for "I do not care".
        requests: the slots asked for.
        choices: for ``multiple_choice`` only, the values offered of the one slot in ``requests``.

    Examples:
        >>> str(Frame("request", {"moviename": "wonka"}, ("theater", "date")))
        'request(theater, date) inform(moviename=wonka)'
        >>> Frame.parse("inform(city=reno) request(date)").requests
        ('date',)
    """

    act: str
    informs: Mapping[str, str] = field(default_factory=dict)
    requests: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()

    @property
    def dont_care(self) -> tuple[str, ...]:
        """The slots that the speaker does not care about."""
        return tuple(slot for slot, value in self.informs.items() if value == ANY)

    def __str__(self) -> str:
        if self.choices:
            return f"{self.act}({', '.join(f'{self.requests[0]}={v}' for v in self.choices)})"
        parts = {}
        if self.requests:
            parts["request"] = f"request({', '.join(self.requests)})"
        if self.informs:
            values = ", ".join(f"{slot}={value}" for slot, value in self.informs.items())
            parts["inform"] = f"inform({values})"
        return " ".join((parts.pop(self.act, self.act), *parts.values()))

    @classmethod
    def parse(cls, text: str, domain: Domain | None = None) -> Frame:
        """Parses a frame in the notation of transcripts.

        Args:
            text: such as ``"request(theater) inform(moviename=wonka)"``.
            domain: the domain whose acts and slots are allowed; ``None`` allows all.

        Raises:
            ValueError: if the notation is wrong, or the act or a slot is unknown.
        """
        act = ""
        informs: dict[str, str] = {}
        requests: list[str] = []
        choices: list[str] = []
        if _FRAME.fullmatch(text.strip()) is None:
            raise ValueError(
                f"a frame is written 'act', 'request(slot)' or 'inform(slot=value)', "
                f"got {shown(text)}"
            )
        for match in _PART.finditer(text):
            act = act or match["act"]
            for item in (
                re.split(r",\s+(?=\w+(?:=|,|$))", match["content"]) if match["content"] else ()
            ):
                slot, has_value, value = item.partition("=")
                if match["act"] == "multiple_choice":
                    requests, choices = [slot], [*choices, value]
                elif bool(has_value) != (match["act"] == "inform") or slot in informs:
                    raise ValueError(
                        f"a frame requests slots and informs slot=value once, got {shown(text)}"
                    )
                elif has_value:
                    informs[slot] = value
                else:
                    requests.append(slot)
        if domain is not None:
            check("the act", act, one_of(*domain.acts))
            for slot in (*informs, *requests):
                check("a slot", slot, one_of(*domain.slots))
        return cls(act, informs, tuple(requests), tuple(choices))


_USER_ACTS = ("request", "inform", "deny", "thanks", "closing")
"""The acts of simulated users, the only ones that agents are trained on."""


class Coding:
    """Encodes a domain's acts, slots and values as ids, and decodes them.

    Args:
        domain: the domain's tensors.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain, tensorize
        >>> coding = Coding(tensorize(movie_domain()))
        >>> ids = coding.ids({"city": "Reno", "date": "I do not care"})
        >>> coding.values(ids)
        {'city': 'reno', 'date': 'I do not care'}
    """

    def __init__(self, domain: DomainTensors) -> None:
        self.acts, self.slots = tuple(domain.act), tuple(domain.slot)
        self._complete = self.slots[domain.complete]
        self._vocabulary = domain.vocabulary
        self._ids = value_ids(domain.vocabulary)

    def frame(self, act: int, informs: Sequence[int], requests: Sequence[bool]) -> Frame:
        """Returns the frame of an act, value ids ``[S]`` and requested slots ``[S]``."""
        requested = (slot for slot, is_set in zip(self.slots, requests, strict=True) if is_set)
        return Frame(self.acts[act], self.values(informs), tuple(requested))

    def values(self, ids: Sequence[int]) -> dict[str, str]:
        """Returns the values of the ids ``[S]`` by slot, without those that are 0."""
        return {
            slot: self._vocabulary[number][value]
            for number, (slot, value) in enumerate(zip(self.slots, ids, strict=True))
            if value != NONE
        }

    def ids(self, values: Mapping[str, str]) -> list[int]:
        """Returns the value ids ``[S]``; unknown values become 0."""
        return [
            ids.get(fold(values[slot]), NONE) if slot in values else NONE
            for slot, ids in zip(self.slots, self._ids, strict=True)
        ]

    def flags(self, requests: Sequence[str]) -> list[bool]:
        """Returns a flag for every slot, ``[S]``: whether it is requested."""
        return [slot in requests for slot in self.slots]

    def act(self, heard: Frame, question: Frame | None, before: str) -> str:
        """Returns the simulated user's act that comes closest to a person's.

        Args:
            heard: the frame understood.
            question: the agent's last act; ``None`` at the opening.
            before: the act heard in the turn before, repeated by a turn without content.
        """
        if heard.act in _USER_ACTS:
            return heard.act
        if heard.requests:
            return "request"
        if heard.informs:
            return "inform"
        is_offered = question is not None and self._complete in question.informs
        if heard.act == "confirm_answer" and is_offered:
            return "thanks"
        return before
