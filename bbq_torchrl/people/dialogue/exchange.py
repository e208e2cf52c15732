"""What passes between a person and an agent: the agent's memory, and its answer to a text."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from bbq_torchrl.domains.values import RESERVED_TEXT
from bbq_torchrl.people.language import Frame, Understood
from bbq_torchrl.people.language.asking import Asking

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Memory:
    """Everything that an agent remembers between two texts.

    Attributes:
        state: the state of the tracker; ``None`` before the first act understood.
        asking: the clarification questions since the agent last acted.
        proposal: the values of a record that the agent proposes, by slot.
        times: the number of proposals since the person last told something new.
        refused: what the person refused: values of one record each, or a single one by name.
        lacking: the slots that it was asked for and had no value of.
        shown: the records that the agent has proposed or offered, by slot, the latest last.
        taken: whether the person has just taken a proposal, of which something is to be asked.
        denied: the number of offers that the person has refused.
        texts: the number of texts so far.
    """

    state: TensorDict | None = None
    asking: Asking = field(default_factory=Asking)
    proposal: Mapping[str, str] = field(default_factory=dict)
    times: int = 0
    refused: tuple[Mapping[str, str], ...] = ()
    lacking: tuple[str, ...] = ()
    shown: tuple[Mapping[str, str], ...] = ()
    taken: bool = False
    denied: int = 0
    texts: int = 0

    @property
    def is_offered(self) -> bool:
        """True while the agent's offer stands."""
        return self.state is not None and bool(self.state["offered"])

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
        lists = {name: tuple(content.get(name, ())) for name in ("refused", "lacking", "shown")}
        return cls(**{**content, **lists, "state": state, "asking": Asking(**known)})


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


def values_of(of: Frame | Mapping[str, str]) -> dict[str, str]:
    """Returns the values of a frame or of the tracker, without reserved ones."""
    informs = of.informs if isinstance(of, Frame) else of
    return {slot: value for slot, value in informs.items() if value not in RESERVED_TEXT.values()}


def say(now: Memory, sentence: str, reading: Understood | None = None) -> Answer:
    """Returns a sentence that changes nothing in the dialogue."""
    understood = Frame("not_sure") if reading is None else reading.frame
    return Answer(sentence, reading, understood, Frame("not_sure"), now)


def led(answer: Answer, sentence: str) -> Answer:
    """Returns an answer that begins with another sentence, if that is not empty or in it."""
    is_new = bool(sentence) and sentence not in answer.text
    return replace(answer, text=f"{sentence} {answer.text}") if is_new else answer
