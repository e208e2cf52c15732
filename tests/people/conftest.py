"""Tiny trained runs, and partners to talk with."""

import os

import pytest
from acts import Acts
from filelock import FileLock
from tiny import TINY, composed, without_drawing

from bbq_torchrl.people.chat import Partner, TrainedAgent
from bbq_torchrl.people.dialogue.spelling import Spelling
from bbq_torchrl.people.language import Generator, Understander
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.runs.train import run

SHRUNKEN = (*TINY, "protocol.rounds=1", "protocol.eval_every=0", "spike.policy=random")
SHRUNKEN += ("domain=movie",)


def trained(folder, *more):
    folder.mkdir()
    with without_drawing():
        run(composed(*SHRUNKEN, *more), folder)
    return folder


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Makes a file or folder in the first of pytest-xdist's workers that asks for it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # which the workers share

    def path(name, make):
        with FileLock(folder / f"{name}.lock"):
            if not (folder / name).exists():
                make(folder / f"new_{name}")
                (folder / f"new_{name}").rename(folder / name)
        return folder / name

    return path


@pytest.fixture(scope="session")
def runs(once):
    """One folder of runs: BBQN (two replicas), DQN and, before the extension, bootstrapped DQN."""

    def make(folder):
        folder.mkdir()
        trained(folder / "bbqn", "replicas=2")
        trained(folder / "dqn", "agent=dqn")
        trained(folder / "bootstrap", "agent=bootstrap", "env=domain_ext")

    return once("runs", make)


@pytest.fixture(scope="session")
def agents(runs):
    return {name: TrainedAgent(runs / name) for name in ("bbqn", "dqn", "bootstrap")}


@pytest.fixture(scope="session")
def understand(movie, once):
    """An understander that has seen few sentences: it knows the plain ones."""
    file = once(
        "understander.npz", lambda new: Understander.train(movie, sentences=1_200).save(new)
    )
    return Understander.load(file, movie)


@pytest.fixture(scope="session")
def lexicon(movie):
    return Lexicon(movie)


@pytest.fixture(scope="session")
def mouth(movie):
    return Generator(movie)


@pytest.fixture(scope="session")
def spelling(movie):
    return Spelling(movie)


@pytest.fixture(scope="session")
def partner(agents, mouth, spelling):
    return Partner(agents["bbqn"], Acts(), mouth, spelling, rules=())


@pytest.fixture
def decided(monkeypatch):
    """Makes an agent take given actions, first to last, whatever it sees."""

    def decide(agent, *actions):
        todo = [agent.domain.action_index(action) for action in actions]
        monkeypatch.setattr(agent, "decide", lambda observation, seed, allowed=None: todo.pop(0))

    return decide
