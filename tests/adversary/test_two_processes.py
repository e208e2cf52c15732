"""Two processes on one run folder: one works, the other is refused in a line, nothing is lost."""

import re
import signal

import pytest

from .cases import CONFIGURATIONS
from .folders import assert_same

pytestmark = pytest.mark.slow

NAME = "vime"
BUSY = "is at work in it"
TWO = "two processes on one run folder: one worked, the other was told so in a line"


@pytest.fixture
def place(commands, request):
    """The run folder of both processes."""
    return commands.folder / re.sub(r"\W+", "-", request.node.name)


def new(folder):
    return (*CONFIGURATIONS[NAME], f"hydra.run.dir={folder}")


def killed(commands, folder):
    """Makes an unfinished run."""
    command = commands.start("train", *new(folder))
    command.until((folder / "metrics.csv").exists)
    command.send(signal.SIGKILL)
    assert command.end().code == -signal.SIGKILL


def first(commands, kind, folder):
    """Starts the working process, and stops it in the middle of its work."""
    if kind == "resume":
        killed(commands, folder)
        command = commands.start("train", f"resume={folder}")
        command.until(lambda: command.works_in(folder))
    else:
        command = commands.start("train", *new(folder))
        command.until((folder / "metrics.csv").exists)
    command.send(signal.SIGSTOP)
    return command


@pytest.mark.parametrize("one", ["new", "resume"])
@pytest.mark.parametrize("other", ["new", "resume", "extend"])
def test_who_comes_second_is_told_so(commands, references, place, record_property, one, other):
    reference = references(NAME)
    command = first(commands, one, place)
    arguments = {
        "new": new(place),
        "resume": (f"resume={place}",),
        "extend": (f"resume={place}", "protocol.rounds=9"),
    }[other]

    ended = commands.run("train", *arguments, code=2)

    assert BUSY in ended.line
    command.send(signal.SIGCONT)
    assert command.end().code == 0
    assert_same(place, reference.folder)
    record_property(TWO, 1)


@pytest.mark.parametrize("one", ["new", "resume"])
def test_an_evaluation_beside_a_training_harms_neither(
    commands, references, place, record_property, one
):
    reference = references(NAME)
    command = first(commands, one, place)
    evaluate = ("evaluate", f"policy={place}", "dialogues=2")
    stopped = commands.start(*evaluate).end()
    assert stopped.code == 0 or "has no checkpoint yet" in stopped.line
    command.send(signal.SIGCONT)
    beside = commands.start(*evaluate).end()

    assert beside.code == 0 or "has no checkpoint yet" in beside.line
    assert command.end().code == 0
    assert_same(place, reference.folder)
    commands.run(*evaluate)
    record_property("an evaluation beside a training: neither was harmed", 1)


@pytest.mark.parametrize("kind", ["new", "resume"])
def test_of_two_that_start_at_once_one_works(commands, references, place, record_property, kind):
    reference = references(NAME)
    if kind == "resume":
        killed(commands, place)
    arguments = (f"resume={place}",) if kind == "resume" else new(place)
    both = [commands.start("train", *arguments) for _ in range(2)]
    ends = sorted((command.end() for command in both), key=lambda ended: ended.code)

    assert ends[0].code == 0
    assert ends[1].code == 2
    # The second one may have started after the first one's end.
    assert any(text in ends[1].line for text in (BUSY, "already holds a run", "is finished"))
    assert_same(place, reference.folder)
    record_property(TWO, 1)
