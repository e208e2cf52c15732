"""A conversation with an agent: text in, text out, and the acts and beliefs between."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.values import NONE, RESERVED_TEXT
from bbq_torchrl.people.dialogue.control import Control
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.dialogue.tracking import Acting, Tracking
from bbq_torchrl.people.language import Frame, TextError, Understood
from bbq_torchrl.people.language.asking import Asking
from bbq_torchrl.people.language.words import has_bye, has_yes, is_farewell, is_no, is_yes
from bbq_torchrl.simulator import Simulator

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent
    from bbq_torchrl.people.language import EndpointGenerator, Generator, Nlu


@dataclass(frozen=True)
class Memory:
    """Everything that an agent remembers between two texts.

    Attributes:
        state: the state of the tracker; ``None`` before the first act understood.
        asking: the clarification questions since the agent last acted.
        checked: the slot whose known value the agent asked the person to confirm, or empty.
        texts: the number of texts so far.
    """

    state: TensorDict | None = None
    asking: Asking = field(default_factory=Asking)
    checked: str = ""
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
        return cls(state, Asking(**known), content["checked"], content["texts"])


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

    def reply(self, memory: Memory | None, text: str, seed: int) -> Answer:
        """Answers a text.

        Args:
            memory: the memory in the last answer; ``None`` at the start.
            text: the person's text.
            seed: the seed of everything random in the answer.
        """
        before = memory or Memory()
        now = replace(before, texts=before.texts + 1, checked="")
        asking = before.asking
        words: dict[str, Any] = {"session": seed, "turn": now.texts}
        last = None if before.state is None else self._tracking.answered(before.state)
        try:
            reading = self._understood(text, asking.question(last))
        except TextError as error:
            return self._ask_again(now, None, f"Sorry, I cannot read that: {error}.")
        if "farewell" in self.control.rules:
            is_offer = last is not None and self.domain.complete_slot in last.informs
            if reading.frame.act == "thanks" and has_bye(text) and not is_offer:
                reading = replace(reading, frame=Frame("closing"))
            elif reading.frame.act == "closing" and not is_farewell(text):
                reading = replace(reading, frame=Frame("not_sure"), confidence=0.0)
        if asking.is_check or before.checked:
            checked = self._answer_to_check(before, text, reading.frame)
            if checked is None:
                return self._after_no(before, now, reading, words)
            reading = replace(reading, **checked)
        if asking.asks(self._nlu, reading, self._ask_below):
            values = _values(asking.joined(reading.frame))
            if reading.unclear or not values or "confirm" not in self.control.rules:
                return self._ask_again(now, reading, self._nlg.clarify(reading, **words))
            now = replace(now, asking=asking.checking(reading))
            answered = Frame("not_sure", values)
            sentence = self._nlg.check(values, **words)
            return Answer(sentence, reading, reading.frame, answered, now)
        understood, now = asking.joined(reading.frame), replace(now, asking=Asking())
        if understood.act == "closing" or understood == Frame("greeting"):
            # Not the agent's decision: a greeting is returned, a farewell ends the conversation.
            answered, ended = Frame(understood.act), "person" if understood.act == "closing" else ""
            sentence = self._nlg.agent(answered, **words)
            return Answer(sentence, reading, understood, answered, now, ended=ended)
        return self._act(now, reading, understood, seed, words)

    def _act(
        self, now: Memory, reading: Understood, understood: Frame, seed: int, words: dict[str, Any]
    ) -> Answer:
        """Returns the policy's answer to an act."""
        acted = self._acting.reply(now.state, understood, seed)
        answered, now = acted.answered, replace(now, state=acted.state)
        sentences = [self._nlg.agent(act, kept, **words) for act, kept in acted.parts]
        last, kept = acted.parts[-1]
        known = {slot: value for slot, value in _values(kept).items() if slot in last.requests}
        if last.act == "request" and known and "check" in self.control.rules:
            now = replace(now, checked=last.requests[0])
            sentences[-1] = self._nlg.check(known, **words)
        ended = "agent" if answered.act in ("thanks", "closing") else ""
        if not ended and 2 * now.texts >= self.agent.simulator.max_turn:
            ended = "turns"
        sentence, rules = " ".join(sentences), acted.control
        return Answer(sentence, reading, acted.understood, answered, now, True, ended, rules)

    def _answer_to_check(self, before: Memory, text: str, frame: Frame) -> dict[str, Any] | None:
        """Returns the meaning of a text after "..., is that right?"; ``None`` for a plain no."""
        is_bare = not frame.informs and {*frame.requests} <= {self.domain.ticket_slot}
        if is_no(text) or (is_bare and frame.act == "deny"):
            return None
        says_yes = is_yes(text) or (
            is_bare and (frame.act in ("confirm_answer", "thanks") or has_yes(text))
        )
        if not says_yes:
            return {}
        if before.checked:
            assert before.state is not None
            value = self._tracking.kept(before.state)[before.checked]
            return {"frame": Frame("inform", {before.checked: value}), "confidence": 1.0}
        return {"frame": before.asking.waiting, "confidence": 1.0, "unclear": ()}

    def _after_no(
        self, before: Memory, now: Memory, reading: Understood, words: dict[str, Any]
    ) -> Answer:
        """Returns the next question after a no to "..., is that right?"."""
        if not before.checked:
            again = Understood(Frame("not_sure"), 0.0)
            now = replace(now, asking=Asking(before.asking.times))
            return self._ask_again(now, again, self._nlg.clarify(again, **words))
        assert now.state is not None
        kept = now.state["held"].clone()
        kept[self.domain.slots.index(before.checked)] = NONE
        now = replace(now, state=now.state.replace(held=kept))
        answered = Frame("request", {}, (before.checked,))
        return Answer(self._nlg.agent(answered, **words), reading, reading.frame, answered, now)

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
        values = reading.frame.informs
        if "names" not in rules:
            frame = replace(reading.frame, informs=self._spelling.of(values))
            return replace(reading, frame=frame)
        informed = question.informs if question is not None else {}
        informs, unclear = self._spelling.understood(text, values, informed)
        frame = replace(reading.frame, informs=informs)
        return replace(reading, frame=frame, unclear=(*reading.unclear, *unclear))

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
