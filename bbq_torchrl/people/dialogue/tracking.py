"""The agent's side of a dialogue with a person: what it hears and observes, and its acts."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import compress
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from bbq_torchrl.domains.frames import ANY, NO_MATCH_TEXT, Coding
from bbq_torchrl.domains.values import AVAILABLE, DONT_CARE, FIRST_VALUE, NONE
from bbq_torchrl.people.language import Frame
from bbq_torchrl.simulator import Utterance

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from bbq_torchrl.people.dialogue.control import Control
    from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
    from bbq_torchrl.simulator import Simulator


class Tracking:
    """The agent's knowledge of one dialogue, as pure functions on a state.

    The state is a TensorDict of batch size ``[]`` with the keys of the
    :class:`~bbq_torchrl.simulator.Simulator`'s state that the features use, and
    ``open_requests``.

    A simulated user repeats its unanswered questions in each turn, and sets them aside while it
    answers the agent's. A person asks once, so the tracker keeps the requests until they are
    answered (:meth:`~bbq_torchrl.simulator.tracker.Tracker.ask`). With a simulated user,
    the observations are bit for bit those of the simulator.

    Args:
        simulator: the domain's simulator.
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
        >>> str(tracking.answered(state))
        'request(moviename)'
        >>> state = tracking.hear(state, Frame("inform", {"moviename": "wonka"}))
        >>> tracking.observe(state).shape
        torch.Size([268])
    """

    def __init__(self, simulator: Simulator, active: torch.Tensor) -> None:
        self._simulator = simulator
        self._active = active
        self._coding = Coding(simulator.domain)

    def start(self, understood: Frame) -> TensorDict:
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
        return self.hear(state, understood)

    def act(self, state: TensorDict, action: int) -> TensorDict:
        """Returns the state after an act of the agent, with its values filled in.

        Args:
            state: the state, which is not modified.
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

    def hear(self, state: TensorDict, understood: Frame) -> TensorDict:
        """Returns the state after a person's act.

        Args:
            state: the state, which is not modified.
            understood: the act understood; values that the domain does not know are left out.
        """
        coding, tracker = self._coding, self._simulator.tracker
        before = coding.acts[int(state["heard_act"])]
        act = coding.act(understood, self.answered(state), before)
        utterance = Utterance(
            torch.tensor(self._simulator.domain.act[act]),
            torch.tensor(coding.ids(understood.informs)),
            torch.tensor(coding.flags(understood.requests)),
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
        """Returns the observation, float32 ``[F]``."""
        return self._simulator.observe(state, self._active)

    def answered(self, state: TensorDict) -> Frame | None:
        """Returns the agent's last act; ``None`` before its first."""
        act = int(state["agent_act"])
        if act < 0:
            return None
        return self._coding.frame(
            act, state["agent_informs"].tolist(), state["agent_requests"].tolist()
        )

    def kept(self, state: TensorDict | None) -> dict[str, str]:
        """Returns the values that the tracker holds or has set aside, by slot."""
        return {} if state is None else self.values(full(state))

    def lent(
        self, state: TensorDict, before: TensorDict | None, slots: Collection[str]
    ) -> TensorDict:
        """Returns a state in which some values are the agent's, if the person never told them.

        Args:
            state: the state.
            before: the state before the person's act.
            slots: their slots.
        """
        if "wished" not in state or before is None:
            return state
        is_lent = torch.tensor([slot in slots for slot in self._coding.slots])
        is_lent &= before["wished"] == 0
        return state.replace(wished=torch.where(is_lent, 0, state["wished"]))

    def open(self, state: TensorDict | None) -> tuple[str, ...]:
        """Returns the slots that the person has asked for and has not been told."""
        if state is None:
            return ()
        asked = (state["heard_requests"] | state["open_requests"]).tolist()
        return tuple(compress(self._coding.slots, asked))

    def aside(self, state: TensorDict | None) -> dict[str, str]:
        """Returns the values that the control has set aside, by slot."""
        return {} if state is None or "aside" not in state else self.values(state["aside"])

    def ids(self, values: Mapping[str, str]) -> list[int]:
        """Returns the ids ``[S]`` of values by slot; 0 for the others."""
        return self._coding.ids(values)

    def values(self, ids: torch.Tensor) -> dict[str, str]:
        """Returns the values of ids ``[S]``, by slot."""
        return self._coding.values(ids.tolist())


def full(state: TensorDict) -> torch.Tensor:
    """Returns the values held, with those that the control set aside, long ``[S]``."""
    aside = state.get("aside", None)
    return state["held"] if aside is None else torch.where(aside != NONE, aside, state["held"])


@dataclass(frozen=True)
class Acted:
    """The acts of one reply.

    Attributes:
        understood: the act that the agent replies to.
        state: the state of the tracker after the acts.
        parts: each act, and the tracker's values before it.
        control: the rules that kept the agent from its preferred act.
        aside: the wishes that the fitting records do not say, by slot; an offer has them as well.
    """

    understood: Frame
    state: TensorDict
    parts: tuple[tuple[Frame, dict[str, str]], ...]
    control: tuple[str, ...]
    aside: Mapping[str, str] = field(default_factory=dict)

    @property
    def answered(self) -> Frame:
        """All acts as one: the last act, with the values that earlier answers inform.

        An offer's "I do not care" does not replace an answer.
        """
        *answers, (last, _) = self.parts
        informs = {slot: value for act, _ in answers for slot, value in act.informs.items()}
        later = {s: value for s, value in last.informs.items() if s not in informs or value != ANY}
        return Frame(last.act, {**informs, **later, **self.aside}, last.requests)


class Acting:
    """The acts of an agent under the dialogue control.

    Args:
        agent: the policy.
        tracking: the agent's knowledge.
        control: the rules.

    Attributes:
        place: bool ``[S]``, the slots that say where and when a record is: the essential ones.
    """

    def __init__(self, agent: TrainedAgent, tracking: Tracking, control: Control) -> None:
        self._agent, self._tracking, self._control = agent, tracking, control
        domain = agent.domain
        self._ticket, self._complete = domain.ticket_slot, domain.complete_slot
        booking = domain.action_index(f"inform({domain.complete_slot})")
        self._booking = torch.arange(len(agent.legal)) == booking
        self.place = torch.tensor([slot in domain.essential for slot in domain.slots])
        # What a booking needs and no record has, and how to ask for it.
        self._of_person = {
            domain.slots.index(action.slot): number
            for number, action in enumerate(domain.actions)
            if action.act == "request" and agent.legal[number] and "asks_first" in control.rules
            if action.slot in domain.essential and action.slot in domain.free_slots
        }

    def hear(self, state: TensorDict | None, understood: Frame) -> TensorDict:
        """Returns the state after a person's act; ``state`` is ``None`` before the first.

        Its key ``offered``, bool ``[]``, is whether an offer stands: nothing that the person has
        told since is new.
        """
        if state is None:
            heard = self._tracking.start(understood)
            own = {"offered": torch.tensor(False), "times_asked": heard["agent_requests"].int()}
            return self._control.remember(heard.replace(**own))
        heard = self._tracking.hear(state, understood)
        told = heard["user_informs"]
        is_open = told < FIRST_VALUE  # who tells a value asks for it no more
        heard = heard.replace(
            heard_requests=heard["heard_requests"] & is_open,
            open_requests=heard["open_requests"] & is_open,
        )
        is_known = ((told < FIRST_VALUE) | (told == full(state))).all()
        heard = self._control.remember(heard.replace(offered=state["offered"] & is_known))
        # Who asks where, and does not care, is told one, and that is offered.
        asks = heard["heard_requests"] | heard["open_requests"]
        is_free = asks & (full(heard) == DONT_CARE)
        return heard.replace(held=torch.where(is_free, NONE, heard["held"]))

    def book(
        self,
        state: TensorDict | None,
        understood: Frame,
        seed: int,
        refused: Sequence[Sequence[tuple[int, int]]] = (),
    ) -> Acted:
        """Returns the reply to a yes that adds values to an offer: with them, and the end."""
        offer = self.reply(state, understood, seed, refused, self._booking)
        if not bool(offer.state["offered"]):
            return offer
        end = self.reply(offer.state, Frame("thanks"), seed)
        is_end = end.answered.act in ("thanks", "closing")  # no question was open
        parts = (*offer.parts, *end.parts) if is_end else end.parts
        return replace(end, understood=understood, parts=parts)

    def reply(
        self,
        state: TensorDict | None,
        understood: Frame,
        seed: int,
        refused: Sequence[Sequence[tuple[int, int]]] = (),
        legal: torch.Tensor | None = None,
    ) -> Acted:
        """Returns the acts that reply to a person's act.

        Args:
            state: the state before the person's act; ``None`` before the first.
            understood: the person's act.
            seed: the seed of the policy's random choices.
            refused: what the person refused, as pairs of slot and value id.
            legal: bool ``[A]``, the actions allowed; ``None`` for the agent's.
        """
        agent, control = self._agent, self._control
        legal = agent.legal if legal is None else legal
        is_offered = state is not None and bool(state["offered"])
        is_ticket = understood == Frame("request", {}, (self._ticket,))
        if is_ticket and state is not None and "book" in control.rules:
            if is_offered:
                understood = Frame("thanks")
            else:
                legal = self._booking
        state = self.hear(state, understood)
        observation = self._tracking.observe(state)
        action = agent.decide(observation, seed)
        allowed, left_out = control.allowed(state, legal)
        left_out["book"] = agent.legal & ~legal
        rules = tuple(name for name, actions in left_out.items() if actions[action])
        state, parts = self._answer(state, understood, legal, seed)
        if parts:
            follows = control.continues(legal)
            allowed, _ = control.allowed(state, follows & self._booking if is_offered else follows)
            observation = self._tracking.observe(state)
        if not parts or allowed.any():
            if parts or rules:
                action = agent.decide(observation, seed, allowed)
            if self._booking[action]:
                state = self._placed(state, refused)
                is_known = (full(state) != NONE) | (state["times_asked"] > 1) | state["offered"]
                unsaid = (ask for slot, ask in self._of_person.items() if not is_known[slot])
                action = next(unsaid, action)
            state = self._act(state, action, parts)
        aside = {}
        if self._complete in parts[-1][0].informs and "aside" in state:
            is_absent = control.records.having(state["held"]) == 0
            aside = self._tracking.values(torch.where(is_absent, state["aside"], NONE))
        return Acted(understood, state, tuple(parts), rules, aside)

    def _answer(
        self, state: TensorDict, understood: Frame, legal: torch.Tensor, seed: int
    ) -> tuple[TensorDict, list[tuple[Frame, dict[str, str]]]]:
        """Returns the state after the answers to all open questions.

        An answer that no matching record has is told, and not held. The state is then as if the
        person had asked for the ticket, as simulated users do when they have nothing else to ask.
        """
        parts: list[tuple[Frame, dict[str, str]]] = []
        turn = state["turn"]
        while (answers := self._control.answers(state, legal)).any():
            held = state["held"]
            action = self._agent.decide(self._tracking.observe(state), seed, answers)
            state = self._act(state, action, parts)
            if NO_MATCH_TEXT in parts[-1][0].informs.values():
                state = state.replace(held=held)
        if parts:
            aside = self._tracking.aside(state)
            left = aside.keys() | {slot for act, _ in parts for slot in act.informs}
            told = {slot: v for slot, v in understood.informs.items() if slot not in left}
            wish = Frame("request", told, (self._ticket,))
            state = self._tracking.hear(state, wish)
        return state.replace(turn=turn), parts

    def _act(
        self, state: TensorDict, action: int, parts: list[tuple[Frame, dict[str, str]]]
    ) -> TensorDict:
        """Returns the state after an act, and adds it to ``parts``."""
        after = self._tracking.act(state, action)
        answered = self._tracking.answered(after)
        assert answered is not None
        parts.append((answered, self._tracking.values(state["held"])))
        after["times_asked"] = state["times_asked"] + after["agent_requests"]
        if self._booking[action]:
            is_available = after["agent_informs"][self._agent.domain.slots.index(self._complete)]
            is_open = after["agent_informs"] < FIRST_VALUE  # an offer answers what it names
            return after.replace(
                offered=is_available == AVAILABLE,
                heard_requests=after["heard_requests"] & is_open,
                open_requests=after["open_requests"] & is_open,
            )
        # A yes to a later question takes no offer.
        return after.replace(offered=after["offered"] & ~after["agent_requests"].any())

    def _placed(
        self, state: TensorDict, refused: Sequence[Sequence[tuple[int, int]]]
    ) -> TensorDict:
        """Returns the state in which where and when the offered record is counts as told."""
        rules, records = self._control.rules, self._control.records
        if not {"way_out", "take_back"} <= {*rules} or records.best(full(state))[0].any():
            return state
        row = records.row(full(state), {}, refused)
        is_told = self.place & (row != NONE) & (full(state) < FIRST_VALUE)
        held, wished = torch.where(is_told, row, state["held"]), state["wished"]
        return state.replace(held=held, wished=torch.where(is_told, 0, wished))
