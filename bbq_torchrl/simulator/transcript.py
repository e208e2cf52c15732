"""Dialogues as people read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.domains.coding import Coding

if TYPE_CHECKING:
    from tensordict import TensorDictBase

    from bbq_torchrl.domains import DomainTensors
    from bbq_torchrl.domains.frames import Frame


class Transcript:
    """Writes the acts of a dialogue's state as text.

    The act, then what it requests and informs; an act ``request`` or ``inform`` is written with its
    slots, and what belongs to the other follows. What was heard follows in brackets where an
    error made it differ from what the user meant.

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
        return str(self._frame(state, "agent_act", "agent_informs", "agent_requests"))

    def user(self, state: TensorDictBase) -> str:
        """Returns the user's last act: ``"request(theater) inform(moviename=zootopia)"``."""
        meant = str(self._frame(state, "user_act", "meant_informs", "pending"))
        heard = str(self._frame(state, "heard_act", "user_informs", "heard_requests"))
        is_over = bool(state["done"])  # the end is heard as it is; the tracker keeps questions
        return meant if is_over or meant == heard else f"{meant} [heard: {heard}]"

    def goal(self, state: TensorDictBase) -> str:
        """Returns what the user wants: ``"request(ticket) inform(moviename=zootopia)"``."""
        request = self._coding.acts.index("request")
        values, asked = state["constraints"].tolist(), state["requests"].tolist()
        return str(self._coding.frame(request, values, asked))

    def _frame(self, state: TensorDictBase, *keys: str) -> Frame:
        """Returns an act, of its keys of act, values and questions."""
        act, informs, requests = (state[key].tolist() for key in keys)
        return self._coding.frame(act, informs, requests)
