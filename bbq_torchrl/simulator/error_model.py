"""The error channel between user and tracker."""

from __future__ import annotations

from typing import Literal, Protocol, get_args

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bbq_torchrl.domains import DomainTensors
from bbq_torchrl.domains.tensors import Movable, index_below
from bbq_torchrl.domains.values import NONE
from bbq_torchrl.settings import PROBABILITY, check, one_of
from bbq_torchrl.simulator.tracker import AgentTurn, Utterance

SlotErrorMode = Literal["value", "slot", "delete", "mixed"]

ABOVE_IDS = 1 << 32
"""Larger than every value id: ``slot * ABOVE_IDS + value`` encodes a slot and a value."""


class Channel(Protocol):
    """The channel from users to the tracker.

    Attributes:
        slot_draws: names of the uniform numbers ``[*B, S]`` that a turn needs.
        draws: names of the uniform numbers ``[*B]`` that a turn needs.
        mishears_all: whether the opening and requests can be misheard too. If so, the opening needs
            the same numbers as a turn, and the tracker keeps requests until they are answered.
    """

    slot_draws: tuple[str, ...]
    draws: tuple[str, ...]
    mishears_all: bool

    def to(self, device: torch.device | str) -> Channel:
        """Returns a copy with every tensor on ``device``."""

    def transmit(
        self,
        said: Utterance,
        agent: AgentTurn | None,
        before: Tensor,
        is_silent: Tensor,
        draws: TensorDictBase,
        active: Tensor,
    ) -> Utterance:
        """Returns the utterance heard.

        Args:
            said: the users' utterance.
            agent: the agent's act before it; ``None`` at the opening.
            before: long ``[*B]``, the act heard in the turn before; at the opening the one said.
            is_silent: bool ``[*B]``, dialogues that have ended, in which ``said.act`` is heard.
            draws: the numbers named by :attr:`slot_draws` and :attr:`draws`.
            active: bool ``[S]``, the slots that can be heard.
        """


class ErrorModel(Movable):
    """The channel of dialogue acts, which simulates errors of speech recognition and nlu.

    Each informed slot has an error with probability ``slot_error_prob``, independently; requested
    slots have none. The mode decides the error's effect:

    - ``"value"``: the value becomes one of the slot's error values, possibly the same; slots
      without error values stay correct;
    - ``"slot"``: slot and value become those of another active slot with error values; without one
      the slot is deleted. The replacement overrides the value informed of the other slot; of
      several replacements of one slot, that of the highest source slot wins;
    - ``"delete"``: the slot is deleted;
    - ``"mixed"``: each of the three with probability 1/3.

    With probability ``intent_error_prob`` a uniformly random act is heard. The opening has no
    errors. The model is the agenda simulator of Li et al. (2016), in which a bug turns ``"slot"``
    into a deletion.

    Args:
        domain: the domain's tensors.
        slot_error_prob: probability in [0, 1] of an error in an informed slot.
        slot_error_mode: the effect of such an error.
        intent_error_prob: probability in [0, 1] that a random act is heard.

    Raises:
        ValueError: for an invalid probability or mode.
    """

    slot_draws: tuple[str, ...] = ("error", "error_kind", "error_slot", "error_value")
    draws: tuple[str, ...] = ("intent", "intent_act")
    mishears_all = False

    def __init__(
        self,
        domain: DomainTensors,
        slot_error_prob: float = 0.0,
        slot_error_mode: SlotErrorMode = "value",
        intent_error_prob: float = 0.0,
    ) -> None:
        check("slot_error_prob", slot_error_prob, PROBABILITY)
        check("intent_error_prob", intent_error_prob, PROBABILITY)
        check("slot_error_mode", slot_error_mode, one_of(*get_args(SlotErrorMode)))
        self.slot_error_prob = slot_error_prob
        self.slot_error_mode = slot_error_mode
        self.intent_error_prob = intent_error_prob
        self._n_acts = domain.n_acts
        self._count = domain.error_count
        self._has_values = domain.error_count > 0
        self._width = domain.error_values.shape[-1]
        self._values = domain.error_values.flatten()
        self._first = torch.arange(domain.n_slots, device=self._count.device) * self._width

    def transmit(
        self,
        said: Utterance,
        agent: AgentTurn | None,
        before: Tensor,
        is_silent: Tensor,
        draws: TensorDictBase,
        active: Tensor,
    ) -> Utterance:
        """Returns the utterance heard; see :class:`Channel`."""
        if agent is None:
            return Utterance(said.act, said.informs, said.requests)
        act = said.act
        if self.intent_error_prob > 0:
            is_random = (draws["intent"] < self.intent_error_prob) & ~is_silent
            act = torch.where(is_random, index_below(draws["intent_act"], self._n_acts), act)
        return Utterance(act, self._informs(said, draws, active), said.requests)

    def _informs(self, said: Utterance, draws: TensorDictBase, active: Tensor) -> Tensor:
        """Returns the informed values after errors: value ids, long ``[*B, S]``."""
        informs: Tensor = said.informs
        prob: float | Tensor = self.slot_error_prob
        if said.error_prob is not None:
            prob = torch.where(said.error_prob < 0, prob, said.error_prob)
        elif prob == 0.0:
            return informs
        is_hit = (informs != NONE) & (draws["error"] < prob)
        if self.slot_error_mode == "delete":
            return torch.where(is_hit, NONE, informs)
        if self.slot_error_mode == "value":
            place = self._first + index_below(draws["error_value"], self._count)
            return torch.where(is_hit & self._has_values, self._values.take(place), informs)
        if self.slot_error_mode == "slot":
            is_value, is_slot = torch.zeros_like(is_hit), is_hit
        else:
            kind = draws["error_kind"]
            is_value = is_hit & (kind < 1 / 3)
            is_slot = is_hit & (kind >= 1 / 3) & (kind < 2 / 3)
        is_spared = ~is_hit | (is_value & ~self._has_values)
        spared = torch.where(is_spared, informs, NONE)
        return self._overlay(spared, is_value & self._has_values, is_slot, draws, active)

    def _overlay(
        self,
        spared: Tensor,
        is_value: Tensor,
        is_slot: Tensor,
        draws: TensorDictBase,
        active: Tensor,
    ) -> Tensor:
        """Adds the replacements to the values without errors. Returns value ids, long ``[*B, S]``.

        Args:
            spared: long ``[*B, S]``, the values without errors.
            is_value: bool ``[*B, S]``, slots whose value is replaced.
            is_slot: bool ``[*B, S]``, slots that are replaced by another slot.
            draws: the uniform numbers of the turn.
            active: bool ``[S]``.
        """
        n_slots = active.shape[-1]
        slots = torch.arange(n_slots, device=active.device)
        # The candidates in slot order, then the other slots; and each slot's rank as a candidate.
        is_candidate = active & self._has_values
        candidates = (~is_candidate).to(torch.uint8).argsort(stable=True)
        rank = is_candidate.cumsum(0) - 1
        n_others = is_candidate.sum() - is_candidate.long()
        place = index_below(draws["error_slot"], n_others)
        place = place + (is_candidate & (place >= rank)).long()
        target = torch.where(is_slot, candidates.take(place.clamp(max=n_slots - 1)), slots)
        choice = index_below(draws["error_value"], self._count.take(target))
        value = self._values.take(target * self._width + choice)
        # With the source slot in the high bits, a maximum finds each target's last replacement.
        replaces = is_value | (is_slot & (n_others > 0))
        keyed = torch.where(replaces, (slots + 1) * ABOVE_IDS + value, 0)
        last = torch.zeros_like(spared).scatter_reduce(-1, target, keyed, "amax")
        return torch.where(last > 0, last % ABOVE_IDS, spared)
