"""The error channel between user and tracker."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol, get_args

import torch

from bbq_torchrl.checks import PROBABILITY, check, one_of
from bbq_torchrl.domains.tensors import Movable
from bbq_torchrl.domains.values import NONE
from bbq_torchrl.simulator.choices import index_below
from bbq_torchrl.simulator.tracker import AgentTurn, Utterance

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from bbq_torchrl.domains import DomainTensors

SlotErrorMode = Literal["value", "slot", "delete", "mixed"]

ABOVE_IDS = 1 << 32
"""Above every value id: a slot times this plus a value of it are one number."""


class Channel(Protocol):
    """Turns what users say into what the tracker hears.

    Attributes:
        slot_draws: names of the uniform numbers ``[*B, S]`` that a turn is heard by.
        draws: names of those of a turn that are ``[*B]``.
        mishears_all: whether the opening and requests can be misheard as well. Then the opening
            needs the same numbers as a turn, and the tracker keeps requests until they are
            answered.
    """

    slot_draws: tuple[str, ...]
    draws: tuple[str, ...]
    mishears_all: bool

    def to(self, device: torch.device | str) -> Channel:
        """Returns the same channel with every tensor on ``device``."""

    def transmit(
        self,
        said: Utterance,
        agent: AgentTurn | None,
        before: torch.Tensor,
        is_silent: torch.Tensor,
        draws: TensorDictBase,
        active: torch.Tensor,
    ) -> Utterance:
        """Returns what is heard.

        Args:
            said: what the users say.
            agent: what the agent has said before; ``None`` at the opening.
            before: long ``[*B]``, the act heard in the turn before; at the opening the one said.
            is_silent: bool ``[*B]``, dialogues that have ended: there ``said.act`` is heard.
            draws: what :attr:`slot_draws` and :attr:`draws` name.
            active: bool ``[S]``, the slots that can be heard.
        """


class ErrorModel(Movable):
    """The channel of dialogue acts: stands for the errors of speech and language understanding.

    Every slot the user informs is hit with ``slot_error_prob``, independently; requested slots are
    never hit. What a hit does depends on the mode:

    - ``"value"``: the value becomes one of the slot's error values (possibly the same again; a slot
      without such values is spared);
    - ``"slot"``: slot and value become those of another active slot that has error values (deleted
      if there is none). The replacement overrides what was informed of that slot; where several
      replacements meet, that of the highest source slot stays;
    - ``"delete"``: the slot is dropped;
    - ``"mixed"``: one of the three, a third each.

    With ``intent_error_prob`` the act that is heard is any act, all alike. The opening is heard as
    it is. The agenda simulator of
    Li et al. (2016) is the model for all of it (where a slip makes ``"slot"`` a deletion).

    Args:
        domain: the domain's tensors.
        slot_error_prob: probability in [0, 1] that an informed slot is hit.
        slot_error_mode: what a hit does.
        intent_error_prob: probability in [0, 1] that the act is heard as any act.

    Raises:
        ValueError: for a probability or a mode that is not allowed.
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
        before: torch.Tensor,
        is_silent: torch.Tensor,
        draws: TensorDictBase,
        active: torch.Tensor,
    ) -> Utterance:
        """Returns what is heard; see :class:`Channel`."""
        if agent is None:
            return Utterance(said.act, said.informs, said.requests)
        act = torch.where(is_silent, said.act, self.hear(said.act, draws))
        return Utterance(act, self.distort(said.informs, draws, active), said.requests)

    def distort(
        self, informs: torch.Tensor, draws: TensorDictBase, active: torch.Tensor
    ) -> torch.Tensor:
        """Returns what is transmitted of the informed slots: value ids, long ``[*B, S]``.

        Args:
            informs: long ``[*B, S]``, what the user means to inform.
            draws: uniform ``error``, ``error_kind``, ``error_slot`` and ``error_value``, each
                float32 ``[*B, S]``.
            active: bool ``[S]``, the slots that a slot error can put in place.
        """
        if self.slot_error_prob == 0.0:
            return informs
        is_hit = (informs != NONE) & (draws["error"] < self.slot_error_prob)
        if self.slot_error_mode == "delete":
            return torch.where(is_hit, NONE, informs)
        if self.slot_error_mode == "value":
            return torch.where(is_hit & self._has_values, self._other_value(draws), informs)
        if self.slot_error_mode == "slot":
            is_value, is_slot = torch.zeros_like(is_hit), is_hit
        else:
            kind = draws["error_kind"]
            is_value = is_hit & (kind < 1 / 3)
            is_slot = is_hit & (kind >= 1 / 3) & (kind < 2 / 3)
        is_spared = ~is_hit | (is_value & ~self._has_values)
        spared = torch.where(is_spared, informs, NONE)
        return self._overlay(spared, is_value & self._has_values, is_slot, draws, active)

    def hear(self, act: torch.Tensor, draws: TensorDictBase) -> torch.Tensor:
        """Returns the act that is heard, long ``[*B]``.

        Args:
            act: long ``[*B]``, the act that the user means.
            draws: uniform ``intent`` and ``intent_act``, each float32 ``[*B]``.
        """
        if self.intent_error_prob == 0.0:
            return act
        any_act = index_below(draws["intent_act"], self._n_acts)
        return torch.where(draws["intent"] < self.intent_error_prob, any_act, act)

    def _other_value(self, draws: TensorDictBase) -> torch.Tensor:
        """Draws an error value of each slot. Returns value ids, long ``[*B, S]``."""
        return self._values.take(self._first + index_below(draws["error_value"], self._count))

    def _overlay(
        self,
        spared: torch.Tensor,
        is_value: torch.Tensor,
        is_slot: torch.Tensor,
        draws: TensorDictBase,
        active: torch.Tensor,
    ) -> torch.Tensor:
        """Lays what replaces the slots hit over what was spared. Returns ids, long ``[*B, S]``.

        Args:
            spared: long ``[*B, S]``, what is transmitted as it was meant.
            is_value: bool ``[*B, S]``, slots whose value is replaced.
            is_slot: bool ``[*B, S]``, slots that are replaced by another one.
            draws: as for :meth:`distort`.
            active: bool ``[S]``.
        """
        n_slots = active.shape[-1]
        slots = torch.arange(n_slots, device=active.device)
        # The candidates in slot order, then the rest; and each slot's rank among the candidates.
        is_candidate = active & self._has_values
        candidates = (~is_candidate).to(torch.uint8).argsort(stable=True)
        rank = is_candidate.cumsum(0) - 1
        n_others = is_candidate.sum() - is_candidate.long()
        place = index_below(draws["error_slot"], n_others)
        place = place + (is_candidate & (place >= rank)).long()
        target = torch.where(is_slot, candidates.take(place.clamp(max=n_slots - 1)), slots)
        choice = index_below(draws["error_value"], self._count.take(target))
        value = self._values.take(target * self._width + choice)
        # With the source slot in the high bits one maximum finds, for every target, the
        # replacement that comes last.
        replaces = is_value | (is_slot & (n_others > 0))
        keyed = torch.where(replaces, (slots + 1) * ABOVE_IDS + value, 0)
        last = torch.zeros_like(spared).scatter_reduce(-1, target, keyed, "amax")
        return torch.where(last > 0, last % ABOVE_IDS, spared)
