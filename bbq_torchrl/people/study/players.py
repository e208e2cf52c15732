"""The two sides of a study that need networks and language.

Trained agents as the talker, and the simulator's users as participants.
"""

from __future__ import annotations

import hashlib
import logging
import threading
from collections.abc import Callable, Mapping

import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import Coding, Frame
from bbq_torchrl.domains.values import FIRST_VALUE, NO_MATCH
from bbq_torchrl.people.dialogue.exchange import Memory
from bbq_torchrl.people.dialogue.partner import Partner
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
from bbq_torchrl.people.language import Generator, load_phrases
from bbq_torchrl.people.language.asking import repeated
from bbq_torchrl.people.language.phrases import GENERIC, has_own_phrases
from bbq_torchrl.people.language.understander import cached_understander, language_key
from bbq_torchrl.people.study import Reply, Study, StudyError
from bbq_torchrl.runs.folders import run_folder
from bbq_torchrl.simulator import Simulator
from bbq_torchrl.simulator.tracker import AgentTurn
from bbq_torchrl.utils.output import print_error

_log = logging.getLogger(__name__)
_MULTIPLE_CHOICE = "multiple_choice"


class AgentTalker:
    """The agents of a study, from run folders or shipped: text in; text, frames and beliefs out.

    If the user's cache has no understander of the domain, it is trained first, in about a minute.

    Args:
        study: the study; paths of run folders are relative to the study file's folder.

    Attributes:
        domain: the study's domain, in the spelling of all acts.
        labels: the readable names of the domain's slots.

    Raises:
        StudyError: if agents cannot be loaded or have another domain; it lists all of them.
        ModuleNotFoundError: the extra ``language`` is not installed.
    """

    def __init__(self, study: Study) -> None:
        nlu = cached_understander(study.domain, None, print_error)
        self._language = language_key(study.domain)
        if not has_own_phrases(study.domain):
            _log.warning("the domain %s %s", study.domain.name, GENERIC)
        self.labels = load_phrases(study.domain).names
        spelling = Spelling(study.domain)
        self.domain = spelling.domain
        nlg = Generator(self.domain)
        # The tagger is not thread-safe.
        self._lock = threading.Lock()
        self._partners: dict[str, Partner] = {}
        faults = []
        for name, source in study.terms.agents.items():
            below, rules = study.terms.ask_below.get(name), study.terms.control.get(name)
            try:
                agent = TrainedAgent(run_folder(source, study.path.parent))
                if agent.domain != study.domain:
                    raise ValueError(f"its domain {agent.domain.name} is not the study's")
                partner = Partner(agent, nlu, nlg, spelling, ask_below=below, rules=rules)
                self._partners[name] = partner
            except (ValueError, OSError) as error:
                faults.append(f"the agent {name} cannot be loaded: {error}")
        if faults:
            raise StudyError(str(study.path), faults)

    def fingerprint(self, agent: str) -> str:
        """Returns a hash of the agent's weights, its domain, the language and the rules."""
        partner = self._partners[agent]
        parts = (partner.agent.fingerprint(), self._language, *partner.control.rules)
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()

    def reply(self, agent: str, state: str | None, text: str, seed: int) -> Reply:
        """Answers a text; see :class:`~bbq_torchrl.people.study.Talker`."""
        partner = self._partners[agent]
        with self._lock:
            memory = None if state is None else Memory.from_json(state)
            answer = partner.reply(memory, text, seed)
            beliefs = None
            if answer.acted:
                observation = partner.observe(memory, answer.understood)
                beliefs = partner.agent.beliefs(observation, seed)
        return Reply(
            text=answer.text,
            understood=answer.understood,
            answered=answer.answered,
            confidence=answer.reading.confidence if answer.reading else None,
            ended=answer.ended in ("agent", "person"),  # the study counts turns itself
            state=answer.memory.to_json(),
            beliefs=beliefs,
        )


def make_talker(study: Study) -> AgentTalker:
    """Returns the agents of a study with this package's language layer; torch uses one thread."""
    torch.set_num_threads(1)
    return AgentTalker(study)


class SimulatedUser:
    """A user of the simulator that speaks in sentences, in one conversation.

    It knows what it means and what the agent does, but not what the agent understood. When asked
    again, it repeats itself in other words, or says only the value asked for.

    Args:
        simulator: a simulator without errors, with all slots active.
        speak: the generator of its sentences.
        goal: number of its goal, from 1.
        seed: seed of its choices and its words.
        spelled: returns an agent's values in the spelling of the simulator's domain.
    """

    def __init__(
        self,
        simulator: Simulator,
        speak: Generator,
        goal: int,
        seed: int,
        spelled: Callable[[Mapping[str, str]], Mapping[str, str]] = dict,
    ) -> None:
        self._simulator, self._speak, self._seed = simulator, speak, seed
        self._spelled = spelled
        self._coding = Coding(simulator.domain)
        self._random = torch.Generator().manual_seed(seed)
        draws = simulator.draw_reset((), self._random)
        goals = len(simulator.domain.goal_constraints)
        draws["goal"] = torch.tensor((goal - 0.5) / goals)  # the number that draws this goal
        n_slots = simulator.domain.n_slots
        self._state = simulator.reset(draws, torch.ones(n_slots, dtype=torch.bool))
        self._texts = 0
        self._question: Frame | None = None

    @property
    def satisfied(self) -> bool:
        """True if the last offer met the goal and nothing is unanswered or without a match."""
        state, ticket = self._state, self._simulator.domain.ticket
        is_left = state["pending"] | state["agenda"]
        is_left[ticket] = False
        is_refused = state["history"] == NO_MATCH
        return bool(state["constraints_met"] & ~(is_left | is_refused).any())

    def say(self, said: Frame | None) -> str:
        """Returns its reply to the agent's act; ``None`` begins the conversation."""
        if said is None:
            meant = self._meant()
        elif said.act == "not_sure" and said.informs:  # "..., is that right?"
            told = self._meant().informs
            is_right = all(told.get(slot) == value for slot, value in said.informs.items())
            meant = Frame("confirm_answer" if is_right else "deny")
        elif said.act == "not_sure" or (said.act == _MULTIPLE_CHOICE and said.requests):
            meant = repeated(self._meant(), said.requests)
        else:
            self._question = Frame(said.act, said.informs, said.requests)
            self._reply(said)
            meant = self._meant()
        self._texts += 1
        return self._speak.user(meant, self._question, session=self._seed, turn=self._texts)

    def _meant(self) -> Frame:
        state = self._state
        informs, requests = state["meant_informs"].tolist(), state["pending"].tolist()
        return self._coding.frame(int(state["user_act"]), informs, requests)

    def _reply(self, said: Frame) -> None:
        state, simulator = self._state, self._simulator
        agent = self._turn(said)
        # The agent may answer pending requests in an offer, or before a question.
        told = state["pending"] & (agent.informs >= FIRST_VALUE) & ~agent.is_slot
        state = state.replace(
            history=torch.where(told, agent.informs, state["history"]),
            pending=state["pending"] & ~told,
            agenda=state["agenda"] & ~told,
        )
        draws = simulator.draw_turn((), self._random)
        # A booking repeats the values held, which is all that the user sees of them.
        state = state.replace(held=agent.informs, user_informs=state["meant_informs"])
        reply = simulator.user.reply(state, agent, torch.tensor(False), draws)
        self._state = state.replace(**reply)

    def _turn(self, said: Frame) -> AgentTurn:
        """Returns an agent's act as the tracker completes it; an offer of values is a request."""
        domain, coding = self._simulator.domain, self._coding
        informs = torch.tensor(coding.ids(self._spelled(said.informs)))
        is_booking = coding.slots[domain.complete] in said.informs
        is_choice = said.act == _MULTIPLE_CHOICE
        spoken_of = [domain.slot[slot] for slot in (*said.requests, *said.informs)]
        slots = [domain.complete] if is_booking else spoken_of[:1]
        slot = torch.tensor(slots[0] if slots else 0)
        is_slot = torch.zeros(domain.n_slots, dtype=torch.bool)
        is_slot[slots] = True
        is_request = bool(said.requests) or is_choice
        return AgentTurn(
            act=torch.tensor(domain.act.get(said.act, -1)),
            slot=slot,
            is_slot=is_slot,
            value=informs[slot],
            informs=informs,
            requests=is_slot & is_request,
            is_request=torch.tensor(is_request),
            is_inform=torch.tensor(bool(slots) and not (is_request or is_booking)),
            is_booking=torch.tensor(is_booking),
            is_multiple_choice=torch.tensor(is_choice),
            is_confirm_answer=torch.tensor(said.act == "confirm_answer"),
            is_end=torch.tensor(said.act in ("thanks", "closing")),
            offered=None,
        )


def make_users(study: Study) -> Callable[[int, int], SimulatedUser]:
    """Returns a function that makes a user from the number of its goal, from 1, and a seed."""
    spelling = Spelling(study.domain)
    simulator = Simulator(tensorize(spelling.domain))
    speak = Generator(study.domain)
    return lambda goal, seed: SimulatedUser(simulator, speak, goal, seed, spelling.of)
