"""A conversation with an agent: text in, text out, and the acts and beliefs between."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.frames import ANY, NO_MATCH_TEXT
from bbq_torchrl.domains.values import FIRST_VALUE, RESERVED_TEXT, fold
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.control import Control
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.dialogue.tracking import Acting, Tracking, full
from bbq_torchrl.people.language import Frame, TextError, Understood
from bbq_torchrl.people.language.asking import Asking
from bbq_torchrl.people.language.words import (
    compact,
    has_bye,
    has_yes,
    is_farewell,
    is_no,
    is_yes,
)
from bbq_torchrl.simulator import Simulator

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
    from bbq_torchrl.people.language import EndpointGenerator, Generator, Nlu


_MAX_CHOICES, _MAX_NAMED = 5, 4
_MAX_PROPOSALS = 2
"""The number of refused proposals after which the agent asks what may change."""

_MAX_DENIED = 4
"""The number of refused offers after which the agent ends the conversation."""


@dataclass(frozen=True)
class Memory:
    """Everything that an agent remembers between two texts.

    Attributes:
        state: the state of the tracker; ``None`` before the first act understood.
        asking: the clarification questions since the agent last acted.
        proposal: the other values that the agent has just proposed, by slot.
        refused: the values proposed and refused since the person last told something.
        denied: the number of offers that the person has refused.
        texts: the number of texts so far.
    """

    state: TensorDict | None = None
    asking: Asking = field(default_factory=Asking)
    proposal: Mapping[str, str] = field(default_factory=dict)
    refused: tuple[Mapping[str, str], ...] = ()
    denied: int = 0
    texts: int = 0

    def to_json(self) -> str:
        """Returns the memory as JSON."""
        state = None
        if self.state is not None:
            state = {key: value.tolist() for key, value in self.state.items()}
        return json.dumps(vars(self) | {"state": state, "asking": asdict(self.asking)})

    @classmethod
    def from_json(cls, text: str) -> Memory:
        """Returns the memory that :meth:`to_json` wrote."""
        content = json.loads(text)
        state, asking = content["state"], content["asking"]
        if state is not None:
            state = TensorDict({key: torch.tensor(value) for key, value in state.items()}, [])
        if (waiting := asking["waiting"]) is not None:
            waiting = Frame(waiting["act"], waiting["informs"], tuple(waiting["requests"]))
        known = {**asking, "waiting": waiting, "choices": tuple(asking["choices"])}
        refused = tuple(content["refused"])
        return cls(**{**content, "state": state, "asking": Asking(**known), "refused": refused})


@dataclass(frozen=True)
class Answer:
    """An agent's answer to a text.

    Attributes:
        text: the agent's text.
        reading: the nlu's result for the person's text; ``None`` if it could not be read.
        understood: the act that the agent acted on, merged with the texts it had asked about.
        answered: the agent's act, with its values filled in.
        memory: the agent's memory for the next text.
        acted: whether the agent took an action; otherwise it asked again, or greeted.
        ended: the cause of the end: ``"agent"``, ``"person"`` or ``"turns"``; else ``""``.
        control: the rules that kept the agent from its preferred act.
    """

    text: str
    reading: Understood | None
    understood: Frame
    answered: Frame
    memory: Memory
    acted: bool = False
    ended: str = ""
    control: tuple[str, ...] = ()


class Partner:
    """An agent to talk with; it keeps no conversations, but returns a memory of each.

    Args:
        agent: the policy.
        nlu: the nlu.
        nlg: the nlg.
        spelling: the spelling of values; ``None`` for that of the agent's domain and phrases.
        ask_below: the confidence below which it asks again, between 0 (never) and 1; ``None`` for
            the threshold of the nlu.
        rules: the rules of the dialogue control, see
            :mod:`~bbq_torchrl.people.dialogue.control`; ``None`` for all.

    Attributes:
        agent: the policy.
        domain: the domain, in the spelling that all acts use.
        control: the rules between the policy and the nlg.

    Examples:
        >>> partner = Partner(TrainedAgent("runs/bbqn"), understand, speak)  # doctest: +SKIP
        >>> answer = partner.reply(None, "two tickets for wonka please", seed=0)  # doctest: +SKIP
        >>> answer.text  # doctest: +SKIP
        'Which city are you in?'
        >>> answer = partner.reply(answer.memory, "reno", seed=1)  # doctest: +SKIP
    """

    def __init__(
        self,
        agent: TrainedAgent,
        nlu: Nlu,
        nlg: Generator | EndpointGenerator,
        spelling: Spelling | None = None,
        *,
        ask_below: float | None = None,
        rules: Iterable[str] | None = None,
    ) -> None:
        self.agent, self._ask_below = agent, ask_below
        self._nlu, self._nlg = nlu, nlg
        self._spelling = spelling or Spelling(agent.domain)
        self.domain = self._spelling.domain
        # The agent sees the numbers of matching records, which must match in any spelling.
        simulator = Simulator(tensorize(self.domain), max_turn=agent.simulator.max_turn)
        self._tracking = Tracking(simulator, agent.active)
        self.control = Control(simulator, rules)
        self._acting = Acting(agent, self._tracking, self.control)
        wanted = Counter(slot for goal in self.domain.goals for slot in goal.constraints)
        self._goal_slots = [slot for slot, _ in wanted.most_common(_MAX_NAMED)]

    def reply(self, memory: Memory | None, text: str, seed: int) -> Answer:
        """Answers a text.

        Args:
            memory: the memory in the last answer; ``None`` at the start.
            text: the person's text.
            seed: the seed of everything random in the answer.
        """
        before, rules = memory or Memory(), self.control.rules
        now = replace(before, texts=before.texts + 1, proposal={})
        words: dict[str, Any] = {"session": seed, "turn": now.texts}
        question = self._question(before)
        try:
            if "drop" in rules and moves.is_restart(text):
                sentence = self._nlg.say("restart", **words)
                greeting = self._nlg.agent(Frame("request"), **words)
                return self._say(Memory(texts=now.texts), f"{sentence} {greeting}")
            if "help" in rules and (topic := moves.about(text)):
                return self._say(now, self._nlg.say(topic, self._goal_slots, **words))
            reading = self._understood(text, question)
        except TextError as error:
            return self._ask_again(now, None, f"Sorry, I cannot read that: {error}.")
        is_offered = before.state is not None and bool(before.state["offered"])
        reading = self._leaving(reading, text, is_offered)
        is_wish = bool(_values(reading.frame)) and not moves.asks(text)
        others = "way_out" in rules and moves.asks_for_others(text) and not is_wish
        if before.proposal:
            if moves.accepts(text):
                reading = Understood(Frame("inform", before.proposal), 1.0)
            elif is_no(text) or self._is_bare(reading.frame, "deny"):
                return self._alternative(before, now, reading, words)
        elif before.asking.is_check:
            checked = self._answer_to_check(before, text, reading.frame)
            if checked is None:
                again = Understood(Frame("not_sure"), 0.0)
                now = replace(now, asking=Asking(before.asking.times))
                return self._ask_again(now, again, self._nlg.clarify(again, **words))
            reading = replace(reading, **checked)
        elif is_offered and "yes_ends" in rules and not others:
            reading = self._to_offer(before, reading, text)
            if reading.frame.act == "not_sure" and not reading.unclear:
                use = "not_on_file" if moves.asks(text) else "stands"
                return self._say(now, self._nlg.say(use, **words), reading)
        elif "book" in rules and moves.accepts(text) and self._is_bare(reading.frame):
            reading = replace(reading, confidence=1.0)
        dropped: tuple[str, ...] = ()
        if "drop" in rules:
            reading, dropped = self._dropped(before, reading, text, question)
        if others and not dropped:
            found = self._others(before, now, reading, text, words)
            if found is not None:
                return found
        if before.asking.asks(self._nlu, reading, self._ask_below):
            is_question = "help" in rules and moves.asks(text) and "?" in text
            if is_question and not reading.unclear and self._is_bare(reading.frame):
                return self._say(now, self._nlg.say("unknown_question", **words), reading)
            values = _values(before.asking.joined(reading.frame))
            if reading.unclear or not values or "confirm" not in rules:
                return self._ask_again(now, reading, self._nlg.clarify(reading, **words))
            now = replace(now, asking=now.asking.checking(reading))
            answered = Frame("not_sure", values)
            sentence = self._nlg.say("check", values=values, **words)
            return Answer(sentence, reading, reading.frame, answered, now)
        understood, now = before.asking.joined(reading.frame), replace(now, asking=Asking())
        if understood.act == "closing" or understood == Frame("greeting"):
            # Not the agent's decision: a greeting is returned, a farewell ends the conversation.
            answered, ended = Frame(understood.act), "person" if understood.act == "closing" else ""
            sentence = self._nlg.agent(answered, **words)
            return Answer(sentence, reading, understood, answered, now, ended=ended)
        answer = self._act(now, reading, understood, seed, words)
        if dropped:
            said = self._nlg.say("dropped", dropped, **words)
            answer = replace(answer, text=f"{said} {answer.text}")
        return answer

    def _question(self, before: Memory) -> Frame | None:
        """Returns the agent's act that the next text answers."""
        if before.proposal:
            return Frame("confirm_question")
        last = None if before.state is None else self._tracking.answered(before.state)
        return before.asking.question(last)

    def _leaving(self, reading: Understood, text: str, is_offered: bool) -> Understood:
        """Returns a reading that ends the conversation only at words of farewell."""
        if "farewell" in self.control.rules:
            if reading.frame.act == "thanks" and has_bye(text) and not is_offered:
                return replace(reading, frame=Frame("closing"))
            if reading.frame.act == "closing" and not is_farewell(text):
                return replace(reading, frame=Frame("not_sure"), confidence=0.0)
        return reading

    def _is_bare(self, frame: Frame, *acts: str) -> bool:
        """Returns whether a frame of one of some acts has no values, and asks for no slot."""
        is_empty = not frame.informs and {*frame.requests} <= {self.domain.ticket_slot}
        return is_empty and (not acts or frame.act in acts)

    def _to_offer(self, before: Memory, reading: Understood, text: str) -> Understood:
        """Returns the meaning of a reply to an offer: "thanks" if it accepts and says nothing else.

        It is "not sure" if it neither accepts nor says anything that can be acted on.
        """
        frame, asks = reading.frame, moves.asks(text)
        assert before.state is not None
        is_repeated = frame.informs.items() <= self._tracking.kept(before.state).items()
        repeats = bool(frame.informs) and is_repeated and not frame.requests and has_yes(text)
        if moves.accepts(text) or (repeats and not moves.hesitates(text)):
            return Understood(Frame("thanks"), 1.0, source=reading.source)
        if is_no(text):
            return replace(reading, frame=Frame("deny"), confidence=1.0, unclear=())
        is_vague = self._is_bare(frame) and frame.act not in ("deny", "closing")
        is_vague = is_vague or (self._is_bare(frame, "deny") and moves.hesitates(text))
        is_vague = is_vague or (asks and self._nlu.asks(reading) and not frame.informs)
        if asks and frame.informs and not frame.requests:  # "Do they have wheelchair access?"
            heard = self._acting.hear(before.state, frame)
            aside = self._tracking.values(heard["aside"]) if "aside" in heard else {}
            is_vague = not aside.keys().isdisjoint(frame.informs) or self.control.is_stuck(heard)
            is_vague = is_vague and not moves.asks_for_others(text)
        if not is_vague:
            return reading
        listed = [slot for slot in self.domain.slots if self._is_listed(slot)]
        if named := self._spelling.named(text, listed) if asks else ():
            requests = tuple(slot for slot in frame.requests if slot in named) or named[:1]
            return Understood(Frame("request", {}, requests), 1.0, source=reading.source)
        lexicon, name = self._spelling.lexicon, text.strip(" .!")
        if slot := lexicon.only_slot(name) or lexicon.owners.get(compact(name)):
            value = self._spelling.of({slot: lexicon.link(slot, name).values[0]})
            return Understood(Frame("inform", value), 1.0, source=reading.source)
        return replace(reading, frame=Frame("not_sure"), unclear=() if asks else reading.unclear)

    def _dropped(
        self, before: Memory, reading: Understood, text: str, question: Frame | None
    ) -> tuple[Understood, tuple[str, ...]]:
        """Returns a reading in which wishes are taken back, and their slots if that is news."""
        held = {} if before.state is None else self._tracking.kept(before.state)
        held = {**held, **(before.asking.waiting.informs if before.asking.waiting else {})}
        told = reading.frame.informs
        slots = tuple(
            slot
            for slot in moves.taken_back(text, held, self._spelling.lexicon)
            if told.get(slot, ANY) in (ANY, held.get(slot))
        )
        if not slots:
            is_free = bool(told) and set(told.values()) == {ANY}
            if is_free and "?" in text and not reading.frame.requests:  # "Any discounts?"
                return replace(reading, frame=Frame("not_sure"), confidence=0.0), ()
            return reading, ()
        informs = {slot: value for slot, value in told.items() if value != ANY}
        requests = tuple(slot for slot in reading.frame.requests if slot not in slots)
        informs |= dict.fromkeys(slots, ANY)
        frame = replace(reading.frame, informs=informs, requests=requests)
        if frame.act not in ("inform", "request"):
            frame = replace(frame, act="request" if frame.requests else "inform")
        unclear = tuple(one for one in reading.unclear if one.slot not in slots)
        asked = question.requests if question is not None else ()
        news = tuple(slot for slot in slots if slot in held or slot not in asked)
        return replace(reading, frame=frame, confidence=1.0, unclear=unclear), news

    def _others(
        self, before: Memory, now: Memory, reading: Understood, text: str, words: dict[str, Any]
    ) -> Answer | None:
        """Returns the alternatives that a text asks for; ``None`` if it is about something else."""
        lexicon, domain = self._spelling.lexicon, self.domain
        joined = _values(before.asking.joined(reading.frame))
        told = {k: value for k, value in joined.items() if not moves.asks_for_others(value)}
        state = self._acting.hear(before.state, Frame("inform", told))
        slots = moves.named_slots(text, lexicon)
        way = moves.direction(text)
        if not slots and way:
            slots = [slot for slot in lexicon.slots if lexicon.kinds[slot] == "time"]
        question = self._question(before)
        if not slots and question is not None and question.requests and not before.proposal:
            slots = [question.requests[0]]
        slots = [slot for slot in slots if self._is_listed(slot)]
        if not slots:
            if not (before.proposal or self.control.is_stuck(state) or bool(state["offered"])):
                return None
            return self._alternative(before, replace(now, state=state), reading, words)
        number, held = domain.slots.index(slots[0]), full(state)
        found = self.control.records.choices(held, number, way)
        if len(found) < 2:
            refused = self._refused(now)
            change = {number: found[0]} if found else {}
            nearest = self.control.records.nearest
            change = change or nearest(held, refused, slot=number, direction=way)
            change = change or nearest(held, refused, asked=[number])
            return self._propose(replace(now, state=state), reading, change, words)
        ids = torch.zeros_like(held)
        values = []
        for value in found[:_MAX_CHOICES]:
            ids[number] = value
            values.append(self._tracking.values(ids)[slots[0]])
        sentence = self._nlg.say("several", slots[:1], choices=values, **words)
        asking = Asking(slot=slots[0], choices=tuple(values))
        answered = Frame("multiple_choice", {}, (slots[0],), asking.choices)
        now = replace(now, state=state, asking=asking)
        return Answer(sentence, reading, reading.frame, answered, now)

    def _is_listed(self, slot: str) -> bool:
        """Returns whether records have values of a slot that constrains them."""
        return self.control.records.is_listed(self.domain.slots.index(slot))

    def _alternative(
        self, before: Memory, now: Memory, reading: Understood, words: dict[str, Any]
    ) -> Answer:
        """Returns the next proposal, if need be after a refused one."""
        if before.proposal:
            now = replace(now, refused=(*now.refused, before.proposal))
        assert now.state is not None
        change = self.control.records.nearest(full(now.state), self._refused(now))
        if len(now.refused) >= _MAX_PROPOSALS:
            change = {}
        return self._propose(now, reading, change, words)

    def _refused(self, now: Memory) -> list[list[tuple[int, int]]]:
        """Returns the refused proposals as pairs of slot and value id."""
        return [
            [(slot, value) for slot, value in enumerate(self._tracking.ids(one)) if value]
            for one in now.refused
        ]

    def _propose(
        self,
        now: Memory,
        reading: Understood,
        change: Mapping[int, int],
        words: dict[str, Any],
        requests: tuple[str, ...] = (),
    ) -> Answer:
        """Returns the proposal of other values, or the question what may change.

        Args:
            now: the memory, with the state after the person's act.
            reading: the nlu's result.
            change: the value id proposed for each slot that changes; may be empty.
            words: what determines the words.
            requests: the slots asked for; the proposal tells their values.
        """
        assert now.state is not None
        held, records = full(now.state), self.control.records
        now = replace(now, asking=Asking())
        if not change:
            told = records.freeing(held) or (held >= FIRST_VALUE).nonzero().flatten().tolist()
            names = [self.domain.slots[slot] for slot in told][:_MAX_NAMED] or self._goal_slots
            sentence = self._nlg.say("nothing", names, **words)
            return Answer(sentence, reading, reading.frame, Frame("not_sure"), now)
        ids = torch.zeros_like(held)
        ids[[*change]] = torch.tensor([*change.values()])
        proposal = self._tracking.values(ids)
        clash = torch.zeros_like(held)
        conflict = list(records.conflict(held))
        clash[conflict] = held[conflict]
        asked = [self.domain.slots.index(slot) for slot in requests]
        answers = self._tracking.values(records.answers(held, change, asked))
        sentence = self._nlg.say(
            "way_out" if conflict else "another",
            values=self._tracking.values(clash),
            other=proposal | answers,
            **words,
        )
        now = replace(now, proposal=proposal)
        answered = Frame("not_sure", {**proposal, **answers})
        return Answer(sentence, reading, reading.frame, answered, now)

    def _act(
        self, now: Memory, reading: Understood, understood: Frame, seed: int, words: dict[str, Any]
    ) -> Answer:
        """Returns the policy's answer to an act, or the way out if no record has all wishes."""
        before, rules = now.state, self.control.rules
        is_offered = before is not None and bool(before["offered"])
        told = {**understood.informs}
        if told and now.refused and not told.items() <= now.refused[-1].items():
            now = replace(now, refused=())
        if is_offered and self._is_bare(understood, "deny"):
            now = replace(now, denied=now.denied + 1)
            if now.denied >= _MAX_DENIED:
                sentence, answered = self._nlg.say("no_more", **words), Frame("closing")
                return Answer(sentence, reading, understood, answered, now, ended="agent")
        if "way_out" in rules:
            understood, state = self._heard(before, understood)
            if self.control.is_stuck(state):
                asked = tuple(
                    slot for slot in understood.requests if slot != self.domain.ticket_slot
                )
                change = self.control.records.nearest(
                    state["held"],
                    self._refused(now),
                    asked=[self.domain.slots.index(slot) for slot in asked],
                )
                now = replace(now, state=state)
                return self._propose(now, reading, change, words, asked)
        acted = self._acting.reply(before, understood, seed)
        answered, now = acted.answered, replace(now, state=acted.state)
        if is_offered and self._is_bare(understood, "deny") and bool(acted.state["offered"]):
            names = list(_values(self._tracking.kept(acted.state)))[:_MAX_NAMED]
            return self._say(now, self._nlg.say("change", names, **words), reading)
        sentences = [self._nlg.agent(act, kept, **words) for act, kept in acted.parts]
        for slot in acted.aside:
            absent = self._nlg.agent(Frame("inform", {slot: NO_MATCH_TEXT}), **words)
            sentences.insert(0, absent)
        ended = "agent" if answered.act in ("thanks", "closing") else ""
        if not ended and 2 * now.texts >= self.agent.simulator.max_turn:
            ended = "turns"
        sentence, left_out = " ".join(sentences), acted.control
        return Answer(sentence, reading, acted.understood, answered, now, True, ended, left_out)

    def _heard(self, before: TensorDict | None, understood: Frame) -> tuple[Frame, TensorDict]:
        """Returns an act and the state after it.

        A value that no record has with the others is that of another slot, if a record has all of
        them then: "tonight" is a date, or a time.
        """
        lexicon, informs = self._spelling.lexicon, _values(understood)
        state = self._acting.hear(before, understood)
        distance = self.control.records.best(full(state))[2]
        others = product(informs.items(), lexicon.slots if distance else ())
        for (slot, value), other in others:
            # Exactly the same name: "7 pm" is not seven people.
            link = lexicon.link(other, value)
            if other not in informs and link.is_exact and fold(link.values[0]) == fold(value):
                rest = {name: told for name, told in understood.informs.items() if name != slot}
                moved = replace(understood, informs={**rest, **self._spelling.of({other: value})})
                found = self._acting.hear(before, moved)
                if not self.control.records.best(full(found))[2]:
                    return moved, found
        return understood, state

    def _answer_to_check(self, before: Memory, text: str, frame: Frame) -> dict[str, Any] | None:
        """Returns the meaning of a text after "..., is that right?"; ``None`` for a plain no."""
        if is_no(text) or self._is_bare(frame, "deny"):
            return None
        is_bare = self._is_bare(frame)
        if not is_yes(text) and not (
            is_bare and (frame.act in ("confirm_answer", "thanks") or has_yes(text))
        ):
            return {}
        return {"frame": before.asking.waiting, "confidence": 1.0, "unclear": ()}

    def _say(self, now: Memory, sentence: str, reading: Understood | None = None) -> Answer:
        """Returns a sentence that changes nothing in the dialogue."""
        understood = Frame("not_sure") if reading is None else reading.frame
        return Answer(sentence, reading, understood, Frame("not_sure"), now)

    def observe(self, memory: Memory | None, understood: Frame) -> torch.Tensor:
        """Returns the observation, float32 ``[F]``, on which the agent answered an act.

        Args:
            memory: the memory before the text.
            understood: the act that the agent acted on.
        """
        return self._tracking.observe(self._acting.hear((memory or Memory()).state, understood))

    def _understood(self, text: str, question: Frame | None) -> Understood:
        """Returns the meaning of a text, with its values in the one spelling."""
        reading = self._nlu(text, question)
        rules = self.control.rules
        if "aside" in rules and question is not None:
            reading = self._aside(text, question.requests[:1], reading)
        if "answers_first" in rules:
            reading = self._all_questions(text, reading)
        asked = question.requests if question is not None and not question.choices else ()
        if "drop" in rules and asked and moves.is_nothing(text):
            free = Frame("inform", {asked[0]: ANY})
            reading = replace(reading, frame=free, confidence=1.0, unclear=())
        values = reading.frame.informs
        if "names" not in rules:
            frame = replace(reading.frame, informs=self._spelling.of(values))
            return replace(reading, frame=frame)
        informed = question.informs if question is not None else {}
        informs, unclear = self._spelling.understood(text, values, informed)
        frame, unclear = replace(reading.frame, informs=informs), (*reading.unclear, *unclear)
        if "answers_first" in rules and {*frame.requests} - {self.domain.ticket_slot}:
            spoken_of = {action.slot for action in self.domain.actions}
            unclear = tuple(one for one in unclear if one.slot in spoken_of)  # others can wait
        return replace(reading, frame=frame, unclear=unclear)

    def _all_questions(self, text: str, reading: Understood) -> Understood:
        """Returns a reading with the questions of each clause, which are read by themselves."""
        asked = dict.fromkeys(reading.frame.requests)
        for clause in moves.questions(text):
            named = set(self._spelling.named(clause, self.domain.slots))  # "when" names two
            if named and named.isdisjoint(asked):
                alone = self._nlu(clause, None).frame.requests
                asked |= dict.fromkeys(slot for slot in alone if slot in named)
        if len(asked) == len(reading.frame.requests):
            return reading
        frame = Frame("request", reading.frame.informs, tuple(asked))
        return replace(reading, frame=frame)

    def _aside(self, text: str, asked: tuple[str, ...], reading: Understood) -> Understood:
        """Returns the meaning of a text that may ask for something instead of answering."""
        alone = self._nlu(text, None)
        named = self._spelling.named(text, alone.frame.requests, asked)
        is_echo = not set(asked) <= set(named) and set(asked) <= set(reading.frame.requests)
        is_better = alone.confidence > reading.confidence
        if not named or not (is_better or (asked and is_echo)):
            return reading
        frame = Frame("request", reading.frame.informs, named)
        return replace(reading, frame=frame, confidence=alone.confidence)

    def _ask_again(self, now: Memory, reading: Understood | None, sentence: str) -> Answer:
        """Returns a question about a text; the state of the dialogue is unchanged."""
        now = replace(now, asking=now.asking.again(reading))
        understood = answered = Frame("not_sure")
        if reading is not None:
            understood = reading.frame
            if reading.unclear:
                unclear = reading.unclear[0]
                answered = Frame("multiple_choice", {}, (unclear.slot,), unclear.candidates)
        return Answer(sentence, reading, understood, answered, now)


def _values(of: Frame | Mapping[str, str]) -> dict[str, str]:
    """Returns the values of a frame or of the tracker, without reserved ones."""
    informs = of.informs if isinstance(of, Frame) else of
    return {slot: value for slot, value in informs.items() if value not in RESERVED_TEXT.values()}
