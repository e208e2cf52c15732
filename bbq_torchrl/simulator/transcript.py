"""Dialogues as people read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.domains.values import NONE

if TYPE_CHECKING:
    import torch
    from tensordict import TensorDictBase

    from bbq_torchrl.domains import DomainTensors

__all__ = ["Transcript"]


class Transcript:
    """Writes the acts of a dialogue's state as text.

    The act, then what it requests and informs; an act ``request`` or ``inform`` is written with its
    slots, and what belongs to the other follows. What was heard follows in brackets where an
    error made it differ from what the user meant.

    Args:
        domain: the domain's tensors.

    Example:
        >>> from bbq_torchrl.domains import movie_domain, tensorize
        >>> import torch
        >>> from bbq_torchrl.simulator import Simulator
        >>> domain = tensorize(movie_domain())
        >>> simulator, active = Simulator(domain), torch.ones(domain.n_slots, dtype=torch.bool)
        >>> draws = simulator.draw_reset((), torch.Generator().manual_seed(0))
        >>> Transcript(domain).lines(simulator.reset(draws, active))
        ['user: request(...) inform(...)']
    """

    def __init__(self, domain: DomainTensors) -> None:
        self._acts = tuple(domain.act)
        self._slots = tuple(domain.slot)
        self._vocabulary = domain.vocabulary

    def lines(self, state: TensorDictBase) -> list[str]:
        """Returns the last turn of one dialogue, a line each for agent and user.

        The agent's line is left out before its first act.

        Args:
            state: the state of one dialogue, batch size ``[]``.

        Raises:
            ValueError: if the state is one of several dialogues.
        """
        if state.batch_size:
            raise ValueError(
                f"a transcript is of one dialogue: the state must have batch size [], "
                f"got {list(state.batch_size)}"
            )
        user = f"user: {self.user(state)}"
        if int(state["agent_act"]) < 0:
            return [user]
        return [f"agent: {self.agent(state)}", user]

    def agent(self, state: TensorDictBase) -> str:
        """Returns the agent's last act: ``"inform(theater=carmike 16)"``."""
        return self._act(state["agent_act"], state["agent_requests"], state["agent_informs"])

    def user(self, state: TensorDictBase) -> str:
        """Returns the user's last act: ``"request(theater) inform(moviename=zootopia)"``."""
        meant = self._act(state["user_act"], state["pending"], state["meant_informs"])
        heard = self._act(state["heard_act"], state["heard_requests"], state["user_informs"])
        return meant if meant == heard else f"{meant} [heard: {heard}]"

    def goal(self, state: TensorDictBase) -> str:
        """Returns what the user wants: ``"request(ticket) inform(moviename=zootopia)"``."""
        parts = self._parts(state["requests"], state["constraints"])
        return " ".join(parts.values())

    def _act(self, act: torch.Tensor, requests: torch.Tensor, informs: torch.Tensor) -> str:
        name = self._acts[int(act)]
        parts = self._parts(requests, informs)
        return " ".join((parts.pop(name, name), *parts.values()))

    def _parts(self, requests: torch.Tensor, informs: torch.Tensor) -> dict[str, str]:
        asked = [self._slots[slot] for slot in requests.nonzero().flatten().tolist()]
        told = [
            f"{self._slots[slot]}={self._vocabulary[slot][value]}"
            for slot, value in enumerate(informs.tolist())
            if value != NONE
        ]
        parts = {}
        if asked:
            parts["request"] = f"request({', '.join(asked)})"
        if told:
            parts["inform"] = f"inform({', '.join(told)})"
        return parts
