"""The tracker: completes the agent's acts and keeps track of values and requests."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from bbq_torchrl.domains import DomainTensors
from bbq_torchrl.domains.tensors import Movable, index_below, one_hot, rows
from bbq_torchrl.domains.values import AVAILABLE, DONT_CARE, NO_MATCH, NONE
from bbq_torchrl.simulator.knowledge_base import KnowledgeBase


@dataclass(frozen=True)
class AgentTurn:
    """The agent's completed act.

    Args:
        act: long ``[*B]``, the dialogue act.
        slot: long ``[*B]``, its slot, 0 for slotless acts.
        is_slot: bool ``[*B, S]``, one-hot flags of its slot; no flag for slotless acts.
        value: long ``[*B]``, the value it informs: the slot's value, or "ticket available" or
            "no match" for a booking and a multiple choice.
        informs: long ``[*B, S]``, all values it informs; a booking repeats the values held.
        requests: bool ``[*B, S]``, the slot it requests.
        is_request: bool ``[*B]``, it requests its slot.
        is_inform: bool ``[*B]``, it informs its slot, which is not the complete slot.
        is_booking: bool ``[*B]``, it informs the complete slot, that is, it offers a booking.
        is_multiple_choice: bool ``[*B]``, it offers the values of its slot.
        is_confirm_answer: bool ``[*B]``, it asks the user to continue.
        is_end: bool ``[*B]``, it ends the dialogue.
        offered: long ``[*B, C]``, the values that a multiple choice offers, in the order of their
            ids with zeros in between; ``None`` in domains without multiple choices.
    """

    act: Tensor
    slot: Tensor
    is_slot: Tensor
    value: Tensor
    informs: Tensor
    requests: Tensor
    is_request: Tensor
    is_inform: Tensor
    is_booking: Tensor
    is_multiple_choice: Tensor
    is_confirm_answer: Tensor
    is_end: Tensor
    offered: Tensor | None

    def choose(self, uniform: Tensor) -> Tensor:
        """Chooses one of the values offered. Returns value ids, long ``[*B]``.

        Without an offered value it is "I do not care".

        Args:
            uniform: float32 ``[*B]`` in [0, 1).
        """
        assert self.offered is not None
        is_offered = self.offered != NONE
        count = is_offered.sum(-1)
        is_chosen = is_offered.cumsum(-1) > index_below(uniform, count)[..., None]
        position = is_chosen.to(torch.uint8).argmax(-1, keepdim=True)
        chosen = self.offered.gather(-1, position).squeeze(-1)
        return torch.where(count > 0, chosen, DONT_CARE)


@dataclass(frozen=True)
class Utterance:
    """A user's turn, as said or as heard.

    Args:
        act: long ``[*B]``, the act.
        informs: long ``[*B, S]``, the values informed.
        requests: bool ``[*B, S]``, the slots requested.
        repeats: long ``[*B]``, in an utterance heard: the number of times that the user was asked
            to repeat it; ``None``: never.
        error_prob: float32 ``[*B, S]``, in an utterance said: the probability of an error in each
            slot; negative for that of the channel, ``None`` for that of the channel everywhere.
    """

    act: Tensor
    informs: Tensor
    requests: Tensor
    repeats: Tensor | None = None
    error_prob: Tensor | None = None


class Tracker(Movable):
    """A tracker that completes the agent's de-lexicalized actions from the knowledge base.

    Args:
        domain: the domain's tensors.
        knowledge_base: the domain's records.
    """

    def __init__(self, domain: DomainTensors, knowledge_base: KnowledgeBase) -> None:
        self._knowledge_base = knowledge_base
        self._has_choices = domain.has_choices
        self._act, self._acts = domain.action_act, domain.act
        self._slot = domain.action_slot.clamp(min=0)
        self._is_slot = one_hot(domain.action_slot, domain.n_slots)
        self._complete = domain.complete
        slots = torch.arange(domain.n_slots, device=domain.records.device)
        self._is_ticket = slots == domain.ticket
        is_act = {name: self._act == number for name, number in domain.act.items()}
        is_inform = is_act["inform"]
        is_booking = is_inform & (domain.action_slot == domain.complete)
        self._kinds = torch.stack(
            [
                is_act["request"],
                is_inform & ~is_booking,
                is_booking,
                is_act["multiple_choice"],
                is_act["confirm_answer"],
                is_act["thanks"] | is_act["closing"],
                is_booking | (is_inform & (domain.action_slot == domain.ticket)),
            ]
        )

    def complete(self, held: Tensor, action: Tensor) -> AgentTurn:
        """Completes the agent's action from the records that match all values held.

        Args:
            held: long ``[*B, S]``, the values held before the act.
            action: long ``[*B]``, indices of the domain's actions.
        """
        slot, is_slot = self._slot.take(action), rows(self._is_slot, action)
        kinds = self._kinds.index_select(1, action.reshape(-1))
        request, inform, booking, choice, confirm, end, special = kinds.view(
            self._kinds.shape[0], *action.shape
        ).unbind()
        counts, total = self._knowledge_base.counts_by_value(held, slot)
        filled, has_match = self._knowledge_base.most_frequent(counts, slot), total > 0
        offered = None
        if self._has_choices:
            offered = torch.where(counts > 0, self._knowledge_base.counted_values(slot), NONE)
            special = special | choice
            has_match = torch.where(choice, (counts > 0).any(-1), has_match)
        value = torch.where(special, torch.where(has_match, AVAILABLE, NO_MATCH), filled)
        repeated = torch.where(booking[..., None], held, NONE)
        says = is_slot & ~request[..., None]
        return AgentTurn(
            act=self._act.take(action),
            slot=slot,
            is_slot=is_slot,
            value=value,
            informs=torch.where(says, value[..., None], repeated),
            requests=is_slot & request[..., None],
            is_request=request,
            is_inform=inform,
            is_booking=booking,
            is_multiple_choice=choice,
            is_confirm_answer=confirm,
            is_end=end,
            offered=offered,
        )

    @staticmethod
    def hold(held: Tensor, agent: AgentTurn) -> Tensor:
        """Returns the values held after the agent's act, long ``[*B, S]``."""
        is_informed = agent.is_slot & (agent.is_inform | agent.is_booking)[..., None]
        return torch.where(is_informed, agent.value[..., None], held)

    @staticmethod
    def hear(held: Tensor, informs: Tensor) -> Tensor:
        """Returns the values held after the user's act, long ``[*B, S]``; the latest wins."""
        return torch.where(informs != NONE, informs, held)

    def answer(
        self, asked: Tensor, open_requests: Tensor, agent: AgentTurn
    ) -> tuple[Tensor, Tensor]:
        """Removes the requests that the agent's act answers. Returns both kinds of requests.

        Args:
            asked: bool ``[*B, S]``, the current requests before the act.
            open_requests: bool ``[*B, S]``, the same with those set aside.
            agent: the act.
        """
        is_refused = agent.is_booking & (agent.value == NO_MATCH)
        answered = agent.is_slot & agent.is_inform[..., None]
        answered = answered | (self._is_ticket & is_refused[..., None])
        return asked & ~answered, open_requests & ~answered

    def ask(
        self,
        asked: Tensor,
        open_requests: Tensor,
        agent_act: Tensor,
        agent_informs: Tensor,
        agent_requests: Tensor,
        heard: Utterance,
    ) -> tuple[Tensor, Tensor]:
        """Returns both kinds of requests after the user's act, each bool ``[*B, S]``.

        A simulated user repeats its pending requests in each turn, and sets them aside while it
        answers a request of the agent. People ask once, and may be misheard. So the tracker keeps
        requests until they are answered: it sets them aside while the user answers or denies, and
        resumes them once the agent has informed something and the user adds nothing. For a
        simulated user whose requests are heard correctly, both kinds equal the pending requests.

        Args:
            asked: bool ``[*B, S]``, of :meth:`answer`.
            open_requests: bool ``[*B, S]``, of :meth:`answer`.
            agent_act: long ``[*B]``, the agent's act, -1 before its first.
            agent_informs: long ``[*B, S]``, the values that it informs.
            agent_requests: bool ``[*B, S]``, the slot that it requests.
            heard: the user's utterance as heard.
        """
        acts, requests = self._acts, heard.requests
        is_booking = agent_informs[..., self._complete] != NONE
        is_answer = (agent_requests & (heard.informs > DONT_CARE)).any(-1)
        sets_aside = is_answer | (is_booking & (heard.act == acts["deny"]))
        has_informed = (agent_act == acts["inform"]) | (agent_act == acts["confirm_answer"])
        is_empty = ~(requests | (heard.informs != NONE)).any(-1)
        resumes = (has_informed & ~is_booking & is_empty)[..., None]
        kept = torch.where(resumes, open_requests, asked | requests)
        return torch.where(sets_aside[..., None], requests, kept), open_requests | requests
