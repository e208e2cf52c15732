"""A conversation with an agent: text in, text out, and what was understood and thought between."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from bbq_torchrl.domains import tensorize
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.dialogue.tracker import Tracking
from bbq_torchrl.people.language import Frame, TextError, Understood
from bbq_torchrl.people.language.asking import Asking
from bbq_torchrl.simulator import Simulator

if TYPE_CHECKING:
    from bbq_torchrl.people.dialogue.agent import Reasons, TrainedAgent
    from bbq_torchrl.people.dialogue.talk import Beliefs
    from bbq_torchrl.people.language import (
        EndpointGenerator,
        EndpointUnderstander,
        Generator,
        Understander,
    )

    Ears = Understander | EndpointUnderstander
    Mouth = Generator | EndpointGenerator


@dataclass(frozen=True)
class Answer:
    """An agent's answer to a text.

    Attributes:
        text: what the agent says.
        understood: of the person's text; ``None`` where it could not be read.
        heard: the act that the agent acted on, with what was cleared up in later turns.
        said: the agent's act, its values filled in.
        memory: all there is to know to go on, as text.
        acted: whether the agent took an action; otherwise it asked again, or greeted.
        ended: whether the conversation is over: ``"agent"``, ``"person"``, ``"turns"`` or ``""``.
    """

    text: str
    understood: Understood | None
    heard: Frame
    said: Frame
    memory: str
    acted: bool = False
    ended: str = ""


@dataclass(frozen=True)
class _Memory:
    """What is remembered between two texts.

    Attributes:
        state: of the tracking; ``None`` before the first act heard.
        asking: what was asked again since the agent last acted.
        texts: how many there have been.
    """

    state: TensorDict | None = None
    asking: Asking = field(default_factory=Asking)
    texts: int = 0

    def text(self) -> str:
        """Returns it as JSON."""
        state = None
        if self.state is not None:
            state = {key: value.tolist() for key, value in self.state.items()}
        content = {"state": state, "asking": asdict(self.asking), "texts": self.texts}
        return json.dumps(content)

    @classmethod
    def of(cls, text: str | None) -> _Memory:
        """Returns what :meth:`text` wrote; of nothing, the start."""
        if text is None:
            return cls()
        content = json.loads(text)
        state, asking = content["state"], content["asking"]
        if state is not None:
            state = TensorDict({key: torch.tensor(value) for key, value in state.items()}, [])
        if (waiting := asking["waiting"]) is not None:
            waiting = Frame(waiting["act"], waiting["informs"], tuple(waiting["requests"]))
        choices = tuple(asking["choices"])
        return cls(
            state, Asking(asking["times"], waiting, asking["slot"], choices), content["texts"]
        )


class Partner:
    """An agent to talk with; conversations are in the memory that it returns, not in it.

    Args:
        agent: who decides.
        ears: who understands.
        mouth: who speaks.
        spelling: of values; ``None`` for that of the agent's own domain and phrases.
        ask_below: the confidence below which it asks again, between 0 (never) and 1; ``None`` for
            what is usual to who understands.

    Attributes:
        agent: who decides.
        domain: what they talk about, in the spelling that all acts have.

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
        ears: Ears,
        mouth: Mouth,
        spelling: Spelling | None = None,
        *,
        ask_below: float | None = None,
    ) -> None:
        self.agent, self._ask_below = agent, ask_below
        self._ears, self._mouth = ears, mouth
        self._spelling = spelling or Spelling(agent.domain)
        self.domain = self._spelling.domain
        # The agent sees numbers of records: those that match in whichever spelling.
        simulator = Simulator(tensorize(self.domain), max_turn=agent.simulator.max_turn)
        self._tracking = Tracking(simulator, agent.active)

    def reply(self, memory: str | None, text: str, seed: int) -> Answer:
        """Answers a text.

        Args:
            memory: of the last answer; ``None`` at the start.
            text: what the person typed.
            seed: of everything random in the answer.
        """
        before = _Memory.of(memory)
        now = replace(before, texts=before.texts + 1)
        asking = before.asking
        said = None if before.state is None else self._tracking.said(before.state)
        try:
            understood = self._understood(text, asking.question(said))
        except TextError as error:
            return self._ask_again(now, None, f"Sorry, I cannot read that: {error}.")
        if asking.asks(self._ears, understood, self._ask_below):
            sentence = self._mouth.clarify(understood, session=seed, turn=now.texts)
            return self._ask_again(now, understood, sentence)
        heard, now = asking.joined(understood.frame), replace(now, asking=Asking())
        if heard.act == "closing" or heard == Frame("greeting"):
            # Not the agent's decision: a greeting is returned, a farewell ends it.
            said, ended = Frame(heard.act), "person" if heard.act == "closing" else ""
            sentence = self._mouth.agent(said, session=seed, turn=now.texts)
            return Answer(sentence, understood, heard, said, now.text(), ended=ended)
        state = self._hear(now.state, heard)
        action = self.agent.decide(self._tracking.observe(state), seed)
        after = self._tracking.act(state, action)
        said = self._tracking.said(after)
        assert said is not None
        sentence = self._mouth.agent(said, self._tracking.held(state), session=seed, turn=now.texts)
        ended = "agent" if said.act in ("thanks", "closing") else ""
        if not ended and 2 * now.texts >= self.agent.simulator.max_turn:
            ended = "turns"
        now = replace(now, state=after)
        return Answer(sentence, understood, heard, said, now.text(), acted=True, ended=ended)

    def beliefs(self, memory: str | None, heard: Frame, seed: int) -> Beliefs | None:
        """Returns what the agent thought when it heard an act; ``None`` without a posterior.

        Args:
            memory: before the text.
            heard: the act it acted on.
            seed: of the draws.
        """
        return self.agent.beliefs(self._observed(memory, heard), seed)

    def values(self, memory: str | None, heard: Frame, seed: int) -> dict[str, float]:
        """Returns the values that the agent acted on, by action; arguments as of `beliefs`."""
        return self.agent.values(self._observed(memory, heard), seed)

    def reasons(self, memory: str | None, heard: Frame, seed: int) -> Reasons | None:
        """Returns why its best action is better than the second; arguments as of `beliefs`."""
        return self.agent.reasons(self._observed(memory, heard), seed)

    def _observed(self, memory: str | None, heard: Frame) -> torch.Tensor:
        return self._tracking.observe(self._hear(_Memory.of(memory).state, heard))

    def _hear(self, state: TensorDict | None, heard: Frame) -> TensorDict:
        if state is None:
            return self._tracking.start(heard)
        return self._tracking.hear(state, heard)

    def _understood(self, text: str, question: Frame | None) -> Understood:
        """Returns what a text means, its values in the one spelling."""
        understood = self._ears(text, question)
        frame = understood.frame
        return replace(understood, frame=replace(frame, informs=self._spelling.of(frame.informs)))

    def _ask_again(self, now: _Memory, understood: Understood | None, sentence: str) -> Answer:
        """Returns a question about a text; the state of the dialogue stays as it is."""
        now = replace(now, asking=now.asking.again(understood))
        heard = said = Frame("not_sure")
        if understood is not None:
            heard = understood.frame
            if understood.unclear:
                unclear = understood.unclear[0]
                said = Frame("multiple_choice", {}, (unclear.slot,), unclear.candidates)
        return Answer(sentence, understood, heard, said, now.text())
