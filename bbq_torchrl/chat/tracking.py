"""The agent's side of a dialogue with a person: what was heard becomes what the agent sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from bbq_torchrl.domains import DONT_CARE, NO_MATCH, NONE, fold
from bbq_torchrl.language import ANY, Frame

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bbq_torchrl.simulator import Simulator

__all__ = ["Tracking"]

_SAID_BY_USERS = ("request", "inform", "deny", "thanks", "closing")
"""The acts of simulated users: an agent has learned from no others."""


class Tracking:
    """What the agent knows of one dialogue, as pure functions on a state.

    The state is a TensorDict of batch size ``[]`` with those keys of the
    :class:`~bbq_torchrl.simulator.Simulator`'s that the features are made of, and ``open``, bool
    ``[S]``: what was requested and not answered yet.

    A simulated user repeats in each turn what it waits to be told (``pending``), and sets its
    questions aside while it answers the agent's. A person asks once. So requests that were heard
    are kept until they are answered, set aside while the person answers, and shown to the agent
    again once it has told something and the person adds nothing. Of a simulated user, who repeats,
    the agent sees bit for bit what it sees in the simulator.

    Args:
        simulator: of the domain.
        active: bool ``[S]``, the slots active for the agent.

    Example:
        >>> import torch
        >>> from bbq_torchrl.domains import movie_domain, tensorize
        >>> from bbq_torchrl.language import Frame
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
        domain = simulator.domain
        self._acts, self._slots = tuple(domain.act), tuple(domain.slot)
        self._vocabulary = domain.vocabulary
        self._ids = [{fold(text): id_ for id_, text in enumerate(t)} for t in domain.vocabulary]

    def start(self, heard: Frame) -> TensorDict:
        """Returns the state after a person's first turn."""
        n_slots = len(self._slots)
        nothing = torch.zeros(n_slots, dtype=torch.long)
        no_slot = torch.zeros(n_slots, dtype=torch.bool)
        state = TensorDict(
            {
                "held": nothing,
                "user_informs": nothing,
                "pending": no_slot,
                "open": no_slot,
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
        is_refused = agent.is_booking & (agent.value == NO_MATCH)
        ticket = torch.arange(len(self._slots)) == self._simulator.domain.ticket
        answered = (agent.is_slot & agent.is_inform) | (ticket & is_refused)
        return TensorDict(
            {
                **state.to_dict(),
                "held": tracker.hold(state["held"], agent),
                "pending": state["pending"] & ~answered,
                "open": state["open"] & ~answered,
                "agent_act": agent.act,
                "agent_informs": agent.informs,
                "agent_requests": agent.requests,
                "turn": state["turn"] + 2,
            },
            batch_size=[],
        )

    def hear(self, state: TensorDict, heard: Frame) -> TensorDict:
        """Returns the state after a person's act.

        Args:
            state: the state; left as it is.
            heard: what was understood; values that the domain does not know are left out.
        """
        informs = self._encode(heard.informs)
        requests = torch.tensor([slot in heard.requests for slot in self._slots])
        act = self._act(state, heard)
        asked = state["agent_requests"]
        answers = bool((asked & (informs > DONT_CARE)).any())
        is_booking = bool(state["agent_informs"][self._simulator.domain.complete] != NONE)
        said = self._acts[int(state["agent_act"])] if int(state["agent_act"]) >= 0 else ""
        is_new = bool(requests.any() or (informs != NONE).any())
        if answers or (is_booking and act == "deny"):
            pending = requests
        elif said in ("inform", "confirm_answer") and not is_booking and not is_new:
            pending = state["open"]
        else:
            pending = state["pending"] | requests
        return TensorDict(
            {
                **state.to_dict(),
                "held": self._simulator.tracker.hear(state["held"], informs),
                "user_informs": informs,
                "heard_act": torch.tensor(self._simulator.domain.act[act]),
                "pending": pending,
                "open": state["open"] | requests,
            },
            batch_size=[],
        )

    def observe(self, state: TensorDict) -> torch.Tensor:
        """Returns what the agent sees, float32 ``[F]``."""
        return self._simulator.observe(state, self._active)

    def said(self, state: TensorDict) -> Frame | None:
        """Returns the agent's last act; ``None`` before its first."""
        act = int(state["agent_act"])
        if act < 0:
            return None
        asked = state["agent_requests"].nonzero().flatten().tolist()
        informs = self._decode(state["agent_informs"])
        return Frame(self._acts[act], informs, tuple(self._slots[slot] for slot in asked))

    def held(self, state: TensorDict) -> dict[str, str]:
        """Returns the values that the tracker holds, by slot."""
        return self._decode(state["held"])

    def _act(self, state: TensorDict, heard: Frame) -> str:
        """Returns the act of a simulated user that comes nearest."""
        if heard.act in _SAID_BY_USERS:
            return heard.act
        if heard.requests:
            return "request"
        if heard.informs:
            return "inform"
        is_offered = bool(state["agent_informs"][self._simulator.domain.complete] != NONE)
        if heard.act == "confirm_answer" and is_offered:
            return "thanks"
        return self._acts[int(state["heard_act"])]

    def _encode(self, values: Mapping[str, str]) -> torch.Tensor:
        ids = torch.zeros(len(self._slots), dtype=torch.long)
        for number, slot in enumerate(self._slots):
            value = values.get(slot)
            if value is not None:
                found = DONT_CARE if value == ANY else self._ids[number].get(fold(value), NONE)
                ids[number] = found
        return ids

    def _decode(self, ids: torch.Tensor) -> dict[str, str]:
        return {
            slot: self._vocabulary[number][value]
            for number, (slot, value) in enumerate(zip(self._slots, ids.tolist(), strict=True))
            if value != NONE
        }
