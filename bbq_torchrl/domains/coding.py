"""Conversion between dialogue acts as text and the simulator's ids."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.domains.values import NONE, fold, value_ids

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.domains.tensors import DomainTensors

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

    def text(self, slot: int, value: int) -> str:
        """Returns the domain's spelling of a value."""
        return self._vocabulary[slot][value]

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
