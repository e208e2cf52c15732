"""Readable transcripts of dialogues."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.domains.frames import Coding

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from bbq_torchrl.domains import DomainTensors
    from bbq_torchrl.domains.frames import Frame


class Transcript:
    """Formats the acts in a dialogue's state as text.

    A line has the act, then its requests and informs; the acts ``request`` and ``inform`` come with
    their slots, followed by those of the other kind. If an error occurred, the act as heard follows
    in brackets.

    Args:
        domain: the domain's tensors.

    Examples:
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
        self._coding = Coding(domain)

    def lines(self, state: TensorDictBase) -> list[str]:
        """Returns the last turn of one dialogue: the agent's line, if any, and the user's.

        Args:
            state: the state of one dialogue, batch size ``[]``.
        """
        user = f"user: {self.user(state)}"
        if int(state["agent_act"]) < 0:
            return [user]
        return [f"agent: {self.agent(state)}", user]

    def agent(self, state: TensorDictBase) -> str:
        """Returns the agent's last act: ``"inform(theater=carmike 16)"``."""
        return str(self._frame(state, "agent_act", "agent_informs", "agent_requests"))

    def user(self, state: TensorDictBase) -> str:
        """Returns the user's last act: ``"request(theater) inform(moviename=zootopia)"``."""
        meant = str(self._frame(state, "user_act", "meant_informs", "pending"))
        heard = str(self._frame(state, "heard_act", "user_informs", "heard_requests"))
        is_over = bool(state["done"])  # the end has no errors, but the tracker keeps requests
        return meant if is_over or meant == heard else f"{meant} [heard: {heard}]"

    def goal(self, state: TensorDictBase) -> str:
        """Returns the user's goal: ``"request(ticket) inform(moviename=zootopia)"``."""
        request = self._coding.acts.index("request")
        values, requests = state["constraints"].tolist(), state["requests"].tolist()
        return str(self._coding.frame(request, values, requests))

    def _frame(self, state: TensorDictBase, *keys: str) -> Frame:
        """Returns the frame in the state's entries of act, values and requests."""
        act, informs, requests = (state[key].tolist() for key in keys)
        return self._coding.frame(act, informs, requests)
