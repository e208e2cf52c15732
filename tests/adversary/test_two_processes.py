"""Two processes on one run folder: one works, the other is refused in a line, nothing is lost."""

import signal

import pytest

from .cases import CONFIGURATIONS
from .folders import assert_same

pytestmark = pytest.mark.slow

NAME = "vime"


@pytest.fixture
def place(tmp_path):
    """The run folder of both processes."""
    return tmp_path / "run"


@pytest.fixture
def working(commands, place):
    """A training that is stopped in the middle of its work."""
    command = commands.start("train", *CONFIGURATIONS[NAME], f"hydra.run.dir={place}")
    command.until((place / "metrics.csv").exists)
    command.send(signal.SIGSTOP)
    return command


@pytest.mark.parametrize("other", ["new", "resume", "extend"])
def test_who_comes_second_is_told_so(commands, references, place, working, record_property, other):
    arguments = {
        "new": (*CONFIGURATIONS[NAME], f"hydra.run.dir={place}"),
        "resume": (f"resume={place}",),
        "extend": (f"resume={place}", "protocol.rounds=9"),
    }[other]

    ended = commands.run("train", *arguments, code=2)

    assert "is at work in it" in ended.line
    working.send(signal.SIGCONT)
    assert working.end().code == 0
    assert_same(place, references(NAME).folder)
    record_property(
        "two processes on one run folder: one worked, the other was told so in a line", 1
    )


def test_an_evaluation_beside_a_training_harms_neither(
    commands, references, place, working, record_property
):
    evaluate = ("evaluate", f"policy={place}", "dialogues=2")
    stopped = commands.start(*evaluate).end()
    assert stopped.code == 0 or "has no checkpoint yet" in stopped.line
    working.send(signal.SIGCONT)
    beside = commands.start(*evaluate).end()

    assert beside.code == 0 or "has no checkpoint yet" in beside.line
    assert working.end().code == 0
    assert_same(place, references(NAME).folder)
    commands.run(*evaluate)
    record_property("an evaluation beside a training: neither was harmed", 1)
