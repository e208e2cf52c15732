"""Tiny trained runs, and a person who types acts instead of sentences."""

from __future__ import annotations

import pytest
from tiny import TINY, without_drawing

from bbq_torchrl.chat import Partner, TrainedAgent
from bbq_torchrl.chat.spelling import Spelling
from bbq_torchrl.language import Frame, Generator, TextError, Unclear, Understood
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import run

SHRUNKEN = (*TINY, "protocol.rounds=1", "protocol.eval_every=0", "spike.policy=random")


def trained(folder, *more):
    folder.mkdir()
    with without_drawing():
        run(compose([*SHRUNKEN, *more]), folder)
    return folder


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    """One folder of runs: BBQN (two replicas), DQN and, before the extension, bootstrapped DQN."""
    folder = tmp_path_factory.mktemp("runs")
    trained(folder / "bbqn", "replicas=2")
    trained(folder / "dqn", "agent=dqn")
    trained(folder / "bootstrap", "agent=bootstrap", "env=domain_ext")
    return folder


@pytest.fixture(scope="session")
def agents(runs):
    names = ("bbqn", "dqn", "bootstrap")
    return {name: TrainedAgent(runs / name) for name in names}


class Acts:
    """Who reads acts as transcripts write them; not ``?``, and a godzilla is two movies."""

    def __call__(self, text, question=None):
        if text.startswith("\x00"):
            raise TextError("a sentence must have at least one character")
        if text == "?":
            return Understood(Frame("inform"), 0.2)
        if text == "two for godzilla":
            unclear = Unclear("moviename", "godzilla", ("godzilla minus one", "godzilla x kong"))
            return Understood(Frame("inform", {"numberofpeople": "2"}), 0.9, (unclear,))
        if text == "the first":
            return Understood(Frame("inform", {question.requests[0]: question.choices[0]}), 0.9)
        return Understood(Frame.parse(text), 0.99)

    def asks(self, understood):
        return understood.confidence < 0.7 or bool(understood.unclear)


@pytest.fixture(scope="session")
def mouth(movie):
    return Generator(movie)


@pytest.fixture(scope="session")
def spelling(movie):
    return Spelling(movie)


@pytest.fixture
def partner(agents, mouth, spelling):
    return Partner(agents["bbqn"], Acts(), mouth, spelling)


@pytest.fixture
def decided(monkeypatch):
    """Makes an agent take given actions, first to last, whatever it sees."""

    def decide(agent, *actions):
        todo = [agent.domain.action_index(action) for action in actions]
        monkeypatch.setattr(agent, "decide", lambda observation, seed: todo.pop(0))

    return decide
