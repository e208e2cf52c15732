"""The agent's side of a dialogue with a person: what was heard becomes what the agent sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from bbq_torchrl.domains.coding import Coding
from bbq_torchrl.simulator import Utterance

if TYPE_CHECKING:
    from bbq_torchrl.people.language import Frame
    from bbq_torchrl.simulator import Simulator


class Tracking:
    """What the agent knows of one dialogue, as pure functions on a state.

    The state is a TensorDict of batch size ``[]`` with those keys of the
    :class:`~bbq_torchrl.simulator.Simulator`'s that the features are made of, and
    ``open_requests``.

    A simulated user repeats in each turn what it waits to be told, and sets its questions aside
    while it answers the agent's. A person asks once: the tracker keeps requests that were heard
    until they are answered (:meth:`~bbq_torchrl.simulator.tracker.Tracker.ask`). Of a simulated
    user the agent sees bit for bit what it sees in the simulator.

    Args:
        simulator: of the domain.
        active: bool ``[S]``, the slots active for the agent.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.domains import movie_domain, tensorize
        >>> from bbq_torchrl.people.language import Frame
        >>> from bbq_torchrl.simulator import Simulator
        >>> simulator = Simulator(tensorize(movie_domain()))
        >>> tracking = Tracking(simulator, torch.ones(29, dtype=torch.bool))
        >>> state = tracking.start(Frame("request", {"moviename": "wonka"}, ("theater",)))
        >>> state = tracking.act(state, 6)
        >>> str(tracking.said(state))
        'request(moviename)'
        >>> state = tracking.hear(state, Frame("inform", {"moviename": "wonka"}))
        >>> tracking.observe(state).shape
        torch.Size([268])
    """

    def __init__(self, simulator: Simulator, active: torch.Tensor) -> None:
        self._simulator = simulator
        self._active = active
        self._coding = Coding(simulator.domain)

    def start(self, heard: Frame) -> TensorDict:
        """Returns the state after a person's first turn."""
        n_slots = len(self._coding.slots)
        nothing = torch.zeros(n_slots, dtype=torch.long)
        no_slot = torch.zeros(n_slots, dtype=torch.bool)
        state = TensorDict(
            {
                "held": nothing,
                "user_informs": nothing,
                "heard_requests": no_slot,
                "open_requests": no_slot,
                "heard_act": torch.tensor(self._simulator.domain.act["request"]),
                "agent_act": torch.tensor(-1),
                "agent_informs": nothing,
                "agent_requests": no_slot,
                "turn": torch.tensor(0),
            },
            batch_size=[],
        )
        return self.hear(state, heard)

    def act(self, state: TensorDict, action: int) -> TensorDict:
        """Returns the state after an act of the agent, its values filled in.

        Args:
            state: the state; left as it is.
            action: index of one of the domain's actions.
        """
        tracker = self._simulator.tracker
        agent = tracker.complete(state["held"], torch.tensor(action))
        asked, open_ = tracker.answer(state["heard_requests"], state["open_requests"], agent)
        return state.replace(
            held=tracker.hold(state["held"], agent),
            heard_requests=asked,
            open_requests=open_,
            agent_act=agent.act,
            agent_informs=agent.informs,
            agent_requests=agent.requests,
            turn=state["turn"] + 2,
        )

    def hear(self, state: TensorDict, heard: Frame) -> TensorDict:
        """Returns the state after a person's act.

        Args:
            state: the state; left as it is.
            heard: what was understood; values that the domain does not know are left out.
        """
        coding, tracker = self._coding, self._simulator.tracker
        before = coding.acts[int(state["heard_act"])]
        act = coding.act(heard, self.said(state), before)
        utterance = Utterance(
            torch.tensor(self._simulator.domain.act[act]),
            torch.tensor(coding.ids(heard.informs)),
            torch.tensor(coding.flags(heard.requests)),
        )
        asked, open_ = tracker.ask(
            state["heard_requests"],
            state["open_requests"],
            state["agent_act"],
            state["agent_informs"],
            state["agent_requests"],
            utterance,
        )
        return state.replace(
            held=tracker.hear(state["held"], utterance.informs),
            user_informs=utterance.informs,
            heard_act=utterance.act,
            heard_requests=asked,
            open_requests=open_,
        )

    def observe(self, state: TensorDict) -> torch.Tensor:
        """Returns what the agent sees, float32 ``[F]``."""
        return self._simulator.observe(state, self._active)

    def said(self, state: TensorDict) -> Frame | None:
        """Returns the agent's last act; ``None`` before its first."""
        act = int(state["agent_act"])
        if act < 0:
            return None
        return self._coding.frame(
            act, state["agent_informs"].tolist(), state["agent_requests"].tolist()
        )

    def held(self, state: TensorDict) -> dict[str, str]:
        """Returns the values that the tracker holds, by slot."""
        return self._coding.values(state["held"].tolist())
