"""Ctrl-C and SIGTERM at any moment: one line, the right exit code, and a resumable run."""

import os
import re
import signal
import time

import pytest
from forked import process, wait_until

from bbq_torchrl.runs.folders import run_lock

from .cases import CONFIGURATIONS, KILLS, TINY
from .folders import assert_same

pytestmark = pytest.mark.slow

SIGNALS = "Ctrl-C or SIGTERM: one line, exit code 130 or 143, and the run went on"
NUMBERS = (signal.SIGINT, signal.SIGTERM)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_run_that_is_interrupted_says_how_it_goes_on(
    commands, references, rng, record_property, number
):
    name = rng.choice(sorted(CONFIGURATIONS))
    reference = references(name)
    for attempt in range(max(2, KILLS // 4)):
        folder = commands.folder / f"interrupted-{number}-{attempt}"
        new = (*reference.overrides, f"hydra.run.dir={folder}")
        after = rng.uniform(0.02, reference.seconds)
        ended = commands.kill("train", *new, number=number, after=after)
        if ended.code != 0:
            assert ended.code == 128 + number
            if (folder / "config.yaml").exists():
                assert ended.line.endswith(f": python train.py resume={folder} continues it")
                commands.run("train", f"resume={folder}")
            else:
                assert ended.line == "interrupted in bbq train: the same command starts again"
                commands.run("train", *new)
        assert_same(folder, reference.folder)
        record_property(SIGNALS, 1)


def test_a_second_signal_ends_at_once(commands, references):
    folder = commands.folder / "twice"
    longer = ("protocol.dialogues=400", "protocol.epochs=60", "protocol.capacity=4000")
    new = (*CONFIGURATIONS["replicas"], *longer, f"hydra.run.dir={folder}")
    command = commands.start("train", *new)
    command.until((folder / "checkpoint" / "round-000000.torchrl").exists)
    command.work(0.5)
    command.send(signal.SIGINT)
    time.sleep(0.2)
    command.send(signal.SIGINT)

    ended = command.end()

    assert ended.code == 130
    assert re.search(r"^interrupted after (\d) of 4 rounds, (0|2|\1) saved: ", ended.line)


def test_an_evaluation_ends_in_a_line_too(commands):
    given = ("evaluate", "policy=rule", "dialogues=4000000")
    ended = commands.kill(*given, number=signal.SIGINT, after=0.5)
    assert ended.code == 130
    assert ended.line == "interrupted in an evaluation: the same command starts again"


def begun(folder, launcher, at_once):
    """A sweep whose first jobs have begun."""
    keys = (*TINY, "protocol.rounds=4000", "protocol.eval_every=0", "hydra.sweep.dir=sweep")
    started = process("--multirun", "agent=dqn,bbqn", "seed=0,1", launcher, *keys, cwd=folder)
    wait_until(started, lambda: len(list((folder / "sweep").glob("*/metrics.csv"))) == at_once)
    return started


LAUNCHERS = [("hydra.launcher.n_jobs=2", 2), ("hydra/launcher=basic", 1)]


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(("launcher", "at_once"), LAUNCHERS)
def test_the_jobs_of_a_sweep_end_in_good_order(tmp_path, number, launcher, at_once):
    started = begun(tmp_path, launcher, at_once)
    if number == signal.SIGINT:
        os.killpg(started.pid, number)  # as a terminal does
    else:
        started.send_signal(number)

    _, err = started.communicate(timeout=1_800)

    assert started.returncode == 128 + number, err
    assert err.startswith("0 of ")
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("interrupted in a sweep: the same command with ")
    for metrics in (tmp_path / "sweep").glob("*/metrics.csv"):
        rounds = metrics.read_text().count("\n") - 1
        saved = max((metrics.parent / "checkpoint").glob("round-*.torchrl")).stem
        assert int(saved.removeprefix("round-")) == rounds


def test_the_jobs_of_a_sweep_end_with_a_command_that_is_killed(tmp_path):
    started = begun(tmp_path, *LAUNCHERS[0])

    started.kill()
    started.communicate()  # until no process can write any more, including the jobs

    jobs = [metrics.parent for metrics in (tmp_path / "sweep").glob("*/metrics.csv")]
    assert not [job for job in jobs if (job / "result.json").exists()]
    for job in jobs:
        with run_lock(job):
            pass
