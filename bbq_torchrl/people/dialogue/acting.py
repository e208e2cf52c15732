"""The agent's part of a reply: answers to what the person asked, then an act of its choice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.frames import NO_MATCH_TEXT
from bbq_torchrl.people.language import Frame

if TYPE_CHECKING:
    from tensordict import TensorDict

    from bbq_torchrl.people.dialogue.agent import TrainedAgent
    from bbq_torchrl.people.dialogue.control import Control
    from bbq_torchrl.people.dialogue.tracker import Tracking


@dataclass(frozen=True)
class Acted:
    """The acts of one reply.

    Attributes:
        heard: the act that they reply to.
        state: of the tracker, after them.
        parts: each act, and the values held before it.
        control: the rules that kept the agent from the act of its choice.
    """

    heard: Frame
    state: TensorDict
    parts: tuple[tuple[Frame, dict[str, str]], ...]
    control: tuple[str, ...]

    @property
    def said(self) -> Frame:
        """All acts as one: the last, with the values that answers before it inform."""
        *answers, (last, _) = self.parts
        informs = {slot: value for act, _ in answers for slot, value in act.informs.items()}
        return Frame(last.act, {**informs, **last.informs}, last.requests)


class Acting:
    """Acts of an agent within the dialogue control.

    Args:
        agent: the policy.
        tracking: of the agent's knowledge.
        control: the rules.
    """

    def __init__(self, agent: TrainedAgent, tracking: Tracking, control: Control) -> None:
        self._agent, self._tracking, self._control = agent, tracking, control
        domain = agent.domain
        self._ticket, self._complete = domain.ticket_slot, domain.complete_slot
        booking = domain.action_index(f"inform({domain.complete_slot})")
        self._booking = torch.arange(len(agent.legal)) == booking

    def hear(self, state: TensorDict | None, heard: Frame) -> TensorDict:
        """Returns the state after a person's act; ``None`` is before the first."""
        if state is None:
            return self._control.remember(self._tracking.start(heard))
        return self._control.remember(self._tracking.hear(state, heard))

    def reply(self, state: TensorDict | None, heard: Frame, seed: int) -> Acted:
        """Returns the acts that reply to a person's.

        Args:
            state: before the person's act; ``None`` before the first.
            heard: the person's act.
            seed: of what is random in the policy.
        """
        agent, control = self._agent, self._control
        legal = agent.legal
        is_ticket = heard == Frame("request", {}, (self._ticket,))
        if is_ticket and state is not None and "book" in control.rules:
            last = self._tracking.said(state)
            if last is not None and self._complete in last.informs:
                heard = Frame("thanks")
            else:
                legal = self._booking
        state = self.hear(state, heard)
        observation = self._tracking.observe(state)
        action = agent.decide(observation, seed)
        allowed, left_out = control.allowed(state, legal)
        left_out["book"] = agent.legal & ~legal
        rules = tuple(name for name, actions in left_out.items() if actions[action])
        state, parts = self._answer(state, heard, legal, seed)
        if parts:
            allowed, _ = control.allowed(state, control.continues(legal))
            observation = self._tracking.observe(state)
        if not parts or (allowed.any() and NO_MATCH_TEXT not in parts[-1][0].informs.values()):
            if parts or rules:
                action = agent.decide(observation, seed, allowed)
            state = self._act(state, action, parts)
        return Acted(heard, state, tuple(parts), rules)

    def _answer(
        self, state: TensorDict, heard: Frame, legal: torch.Tensor, seed: int
    ) -> tuple[TensorDict, list[tuple[Frame, dict[str, str]]]]:
        """Returns the state after the answers to all open questions, or to one without a match.

        Afterwards it is as if the person had asked for the ticket, as simulated users do who have
        nothing else to ask.
        """
        parts: list[tuple[Frame, dict[str, str]]] = []
        turn = state["turn"]
        while (answers := self._control.answers(state, legal)).any():
            action = self._agent.decide(self._tracking.observe(state), seed, answers)
            state = self._act(state, action, parts)
            if NO_MATCH_TEXT in parts[-1][0].informs.values():
                return state, parts
        if parts:
            state = self._tracking.hear(state, Frame("request", heard.informs, (self._ticket,)))
        return state.replace(turn=turn), parts

    def _act(
        self, state: TensorDict, action: int, parts: list[tuple[Frame, dict[str, str]]]
    ) -> TensorDict:
        """Returns the state after an act, and adds it to ``parts``."""
        after = self._tracking.act(state, action)
        said = self._tracking.said(after)
        assert said is not None
        parts.append((said, self._tracking.held(state)))
        return after
