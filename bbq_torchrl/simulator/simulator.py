"""Batched dialogues: a state, the function from state and action to the next one, and its text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bbq_torchrl.domains import DomainTensors
from bbq_torchrl.domains.frames import Coding, Frame
from bbq_torchrl.domains.tensors import Movable
from bbq_torchrl.domains.values import NO_MATCH, NONE
from bbq_torchrl.settings import check, integers
from bbq_torchrl.simulator.error_model import Channel, ErrorModel
from bbq_torchrl.simulator.features import Features, Rewards
from bbq_torchrl.simulator.knowledge_base import KnowledgeBase
from bbq_torchrl.simulator.profiles import Mix, Users, profiles_of
from bbq_torchrl.simulator.tracker import AgentTurn, Tracker, Utterance
from bbq_torchrl.simulator.user import MixedUser, User

_ACTS_PER_TURN = 2


class Simulator(Movable):
    """Dialogues between an agent and agenda-based users, as pure functions on a state.

    The state of a batch ``[*B]`` of dialogues is a TensorDict:

    ===================  ======  ========  ========================================================
    key                  dtype   shape     meaning
    ===================  ======  ========  ========================================================
    ``goal_id``          long    ``*B``    index of the user's goal in the domain's goals
    ``constraints``      long    ``*B, S``  the goal's value of each slot, 0 without a constraint
    ``requests``         bool    ``*B, S``  the slots the goal requests, including the ticket
    ``agenda``           bool    ``*B, S``  the slots the user has not mentioned yet
    ``pending``          bool    ``*B, S``  the requests the user waits to have answered
    ``history``          long    ``*B, S``  the latest value that either side informed
    ``constraints_met``  bool    ``*B``    the user's verdict on the latest offer of a booking
    ``user_act``         long    ``*B``    the act the user meant
    ``meant_informs``    long    ``*B, S``  the values the user meant to inform
    ``heard_act``        long    ``*B``    the act the tracker heard
    ``user_informs``     long    ``*B, S``  the values transmitted
    ``heard_requests``   bool    ``*B, S``  the requests that the tracker regards as current
    ``open_requests``    bool    ``*B, S``  the same, with those set aside
    ``held``             long    ``*B, S``  the values the tracker holds
    ``agent_act``        long    ``*B``    the agent's last act, -1 before its first
    ``agent_informs``    long    ``*B, S``  the values the agent's last act informed
    ``agent_requests``   bool    ``*B, S``  the slot the agent's last act requested
    ``turn``             long    ``*B``    starts at 0, plus 2 for each turn of the agent
    ``repeats``          long    ``*B``    times that the user was asked to repeat something
    ``done``             bool    ``*B``    the dialogue has ended
    ``success``          bool    ``*B``    it has ended in success
    ``reward``           float   ``*B``    reward of the last turn; 0 at the start
    ===================  ======  ========  ========================================================

    Random choices are functions of uniform numbers that :meth:`draw_reset` and :meth:`draw_turn`
    draw up front; a turn is a pure function of state, action and draws.

    A channel may ask users to repeat something (:class:`~bbq_torchrl.simulator.Utterance`). The
    agent is not involved, and ``turn`` does not count the repetition. It costs a turn nevertheless:
    a turn's reward, added to that of the agent's act before it (at the opening, of its first act),
    and a turn of the limit.

    Args:
        domain: the domain's tensors.
        errors: the error channel between user and tracker, such as an
            :class:`~bbq_torchrl.simulator.ErrorModel`; ``None``: no errors.
        rewards: the rewards of a turn.
        max_turn: acts of both sides after which a dialogue fails, at least 2.
        users: the name of a mix of users, or its
            :class:`profiles <bbq_torchrl.simulator.Profile>`. Users that differ have their traits
            in the state's entry ``traits``.

    Attributes:
        layout: the layout of the features.
        max_agent_turns: the largest number of agent turns in a dialogue; the last of them fails.

    Raises:
        ValueError: if ``max_turn`` is not a whole number of at least 2, the mix is invalid, or it
            has error rates by slot and the channel is not an error model.
    """

    def __init__(
        self,
        domain: DomainTensors,
        *,
        errors: Channel | None = None,
        rewards: Rewards | None = None,
        max_turn: int = 40,
        users: Users = "paper",
    ) -> None:
        self.domain = domain
        self.rewards = Rewards() if rewards is None else rewards
        self.max_turn = check("max_turn", max_turn, integers(_ACTS_PER_TURN))
        self.max_agent_turns = max_turn // _ACTS_PER_TURN + 1
        on_cpu, profiles = domain.to("cpu"), profiles_of(users)
        self.knowledge_base = KnowledgeBase(on_cpu).to(self.device)
        self.errors = ErrorModel(domain) if errors is None else errors
        self.mix = mix = Mix(on_cpu, profiles).to(self.device) if profiles else None
        if mix is not None and mix.has_rates and not isinstance(self.errors, ErrorModel):
            raise ValueError("users with slot_error_prob need a channel that is an ErrorModel")
        self.user = User(domain) if mix is None else MixedUser(domain, mix)
        self.tracker = Tracker(domain, self.knowledge_base)
        self.features = Features(domain, self.knowledge_base)
        self.layout = self.features.layout
        self._is_ticket = torch.arange(domain.n_slots, device=self.device) == domain.ticket

    @property
    def device(self) -> torch.device:
        """The device of the simulator's tensors."""
        return self.domain.records.device

    def action_mask(self, active: Tensor) -> Tensor:
        """Returns the legal actions, bool ``[N]``: slotless acts and actions of active slots.

        Args:
            active: bool ``[S]``.
        """
        slot = self.domain.action_slot
        return (slot < 0) | active[slot.clamp(min=0)]

    def draw_reset(
        self, batch_shape: Sequence[int], generator: torch.Generator | None = None
    ) -> TensorDict:
        """Draws the uniform numbers that start dialogues.

        Returns:
            A TensorDict ``[*B]`` of float32 in [0, 1): ``goal`` ``[*B]``, ``constraint`` and
            ``request`` ``[*B, S]``; the channel's numbers if it can mishear the opening; and those
            of the users' traits.
        """
        per_slot, per_dialogue = ["constraint", "request"], ["goal"]
        for source in (self.errors if self.errors.mishears_all else None, self.mix):
            if source is not None:
                per_slot += source.slot_draws
                per_dialogue += source.draws
        return self._draw(per_slot, per_dialogue, batch_shape, generator)

    def draw_turn(
        self, batch_shape: Sequence[int], generator: torch.Generator | None = None
    ) -> TensorDict:
        """Draws the uniform numbers of one turn.

        Returns:
            A TensorDict ``[*B]`` of float32 in [0, 1): ``agenda`` ``[*B, S]``, ``offer`` ``[*B]``
            and the channel's numbers. Those of an error model are ``error``, ``error_kind``,
            ``error_slot`` and ``error_value`` ``[*B, S]``, ``intent`` and ``intent_act`` ``[*B]``.
        """
        per_slot, per_dialogue = ("agenda", *self.errors.slot_draws), (*self.errors.draws, "offer")
        return self._draw(per_slot, per_dialogue, batch_shape, generator)

    def _draw(
        self,
        per_slot: Sequence[str],
        per_dialogue: Sequence[str],
        batch_shape: Sequence[int],
        generator: torch.Generator | None,
    ) -> TensorDict:
        """Draws uniform numbers in one call and splits them by name, ``[*B, S]`` and ``[*B]``."""
        n_slots = self.domain.n_slots
        width = len(per_slot) * n_slots
        uniform = torch.rand(
            *batch_shape,
            width + len(per_dialogue),
            generator=generator,
            dtype=torch.float32,
            device=self.device,
        )
        by_slot = uniform[..., :width].unflatten(-1, (len(per_slot), n_slots)).unbind(-2)
        scalars = uniform[..., width:].unbind(-1)
        return TensorDict(
            dict(zip((*per_slot, *per_dialogue), (*by_slot, *scalars), strict=True)),
            batch_size=torch.Size(batch_shape),
            device=self.device,
        )

    def reset(self, draws: TensorDictBase, active: Tensor) -> TensorDict:
        """Starts dialogues. Returns the state after the users' first turn.

        Args:
            draws: the numbers of :meth:`draw_reset`, ``[*B]``.
            active: bool ``[S]``; goals are restricted to these slots.
        """
        first = self.user.first_turn(draws, active)
        act, informs = first["user_act"], first["meant_informs"]
        no_value = torch.zeros_like(informs)
        no_slot = torch.zeros_like(first["requests"])
        no_number = torch.zeros_like(act)
        no = torch.zeros_like(act, dtype=torch.bool)
        said = self._said(first)
        heard = self.errors.transmit(said, None, act, no, draws, active)
        return TensorDict(
            {
                **first,
                "history": no_value,
                "constraints_met": no,
                "heard_act": heard.act,
                "user_informs": heard.informs,
                "heard_requests": heard.requests,
                "open_requests": heard.requests,
                "held": heard.informs,
                "agent_act": no_number - 1,
                "agent_informs": no_value,
                "agent_requests": no_slot,
                "turn": no_number,
                "repeats": no_number if heard.repeats is None else heard.repeats,
                "done": no,
                "success": no,
                "reward": no.float(),
            },
            batch_size=draws.batch_size,
            device=self.device,
        )

    def turn(
        self, state: TensorDictBase, action: Tensor, draws: TensorDictBase, active: Tensor
    ) -> TensorDict:
        """Plays one turn: the agent's act and the users' reply. Returns the next state.

        A dialogue that has ended stays as it is, with a reward of 0.

        Args:
            state: the state, ``[*B]``; not modified.
            action: long ``[*B]``, indices of the domain's actions.
            draws: the numbers of :meth:`draw_turn`, ``[*B]``.
            active: bool ``[S]``, the active slots.
        """
        was_done = state["done"]
        agent = self.tracker.complete(state["held"], action)
        turn = torch.where(was_done, state["turn"], state["turn"] + _ACTS_PER_TURN)
        limit = self.max_turn
        if self.mix is not None:
            limit = state["traits", "limit"].clamp(max=self.max_turn)
        is_over = was_done | (turn + _ACTS_PER_TURN * state["repeats"] > limit)
        reply = self.user.reply(state, agent, is_over, draws)
        is_done = is_over | agent.is_end
        success = torch.where(
            was_done, state["success"], self._is_success(state, agent, reply) & ~is_over
        )
        said = self._said(reply)
        heard = self.errors.transmit(said, agent, state["heard_act"], is_done, draws, active)
        reward = self.rewards.of(was_done, is_done, success)
        repeats = state["repeats"]
        if heard.repeats is not None:
            repeats = repeats + heard.repeats
            unpaid = torch.where(state["agent_act"] < 0, repeats, heard.repeats)
            reward = torch.where(was_done, reward, reward + self.rewards.turn * unpaid.float())
        is_kept = was_done[..., None]
        held = self.tracker.hear(self.tracker.hold(state["held"], agent), heard.informs)
        asked = open_ = heard.requests
        if self.errors.mishears_all:
            asked, open_ = self.tracker.answer(
                state["heard_requests"], state["open_requests"], agent
            )
            asked, open_ = self.tracker.ask(
                asked, open_, agent.act, agent.informs, agent.requests, heard
            )
            asked = torch.where(is_kept, state["heard_requests"], asked)
            open_ = torch.where(is_kept, state["open_requests"], open_)
        return TensorDict(
            {
                "goal_id": state["goal_id"],
                "constraints": state["constraints"],
                "requests": state["requests"],
                **reply,
                "heard_act": heard.act,
                "user_informs": heard.informs,
                "heard_requests": asked,
                "open_requests": open_,
                "held": torch.where(is_kept, state["held"], held),
                "agent_act": torch.where(was_done, state["agent_act"], agent.act),
                "agent_informs": torch.where(is_kept, state["agent_informs"], agent.informs),
                "agent_requests": torch.where(is_kept, state["agent_requests"], agent.requests),
                "turn": turn,
                "repeats": repeats,
                "done": is_done,
                "success": success,
                "reward": reward,
            },
            batch_size=state.batch_size,
            device=self.device,
        )

    def _said(self, reply: Mapping[str, Any]) -> Utterance:
        """Returns the users' utterance."""
        has_rates = self.mix is not None and self.mix.has_rates
        rates = reply["traits"]["error_prob"] if has_rates else None
        return Utterance(
            reply["user_act"], reply["meant_informs"], reply["pending"], error_prob=rates
        )

    def observe(self, state: TensorDictBase, active: Tensor) -> Tensor:
        """Returns the features of the states, float32 ``[*B, F]``.

        Args:
            state: the state, ``[*B]``.
            active: bool ``[S]``; features of inactive slots are 0.
        """
        return self.features(state, active)

    def _is_success(
        self, state: TensorDictBase, agent: AgentTurn, reply: dict[str, Tensor]
    ) -> Tensor:
        """Returns whether the agent ends the dialogues in success, bool ``[*B]``."""
        constraints, history = state["constraints"], reply["history"]
        is_left = (reply["pending"] | reply["agenda"]) & ~self._is_ticket
        is_false = (constraints != NONE) & (history != NONE) & (history != constraints)
        spoils = is_left | is_false | (history == NO_MATCH)
        return agent.is_end & state["constraints_met"] & ~spoils.any(-1)


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
