"""Trainings killed repeatedly at any moment end like undisturbed ones."""

import json
import signal

import pytest
from tiny import rows

from .cases import CONFIGURATIONS, KILLS, TINY
from .folders import assert_same

pytestmark = pytest.mark.slow

NAMES = (*CONFIGURATIONS, "sweep", "search")
SHARE = {name: -(-(KILLS - number) // len(NAMES)) for number, name in enumerate(NAMES)}


def go_on(folder, new):
    """The command that resumes the run in a folder, or starts it."""
    return (f"resume={folder}",) if (folder / "config.yaml").exists() else new


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_a_run_that_is_killed_ends_the_same(commands, references, rng, record_property, name):
    reference, kills, attempt = references(name), 0, 0
    while kills < SHARE[name]:
        attempt += 1
        folder = commands.folder / f"{name}-{attempt}"
        new = (*reference.overrides, f"hydra.run.dir={folder}")
        while True:
            ended = commands.kill(
                "train",
                *go_on(folder, new),
                number=signal.SIGKILL,
                after=rng.uniform(0, reference.seconds),
            )
            if ended.code != -signal.SIGKILL:
                break
            kills += 1
            if kills >= SHARE[name]:
                ended = commands.start("train", *go_on(folder, new)).end()
                break
        # The process was killed after its last file, or has ended by itself.
        assert ended.code == 0 or "is finished" in ended.line
        assert_same(folder, reference.folder)
    record_property("kill -9 in a training: resumed to the same, bit for bit", kills)


def test_the_jobs_of_a_sweep_that_is_killed_end_the_same(commands, rng, record_property):
    command = ("--multirun", "hydra/launcher=basic", "agent=dqn,bbqn", *TINY)
    reference = commands.folder / "sweep-reference"
    whole = commands.run("train", *command, f"hydra.sweep.dir={reference}").seconds
    jobs = sorted(path.name for path in reference.iterdir() if path.is_dir())
    assert len(jobs) == 2
    for kill in range(SHARE["sweep"]):
        folder = commands.folder / f"sweep-{kill}"
        ended = commands.kill(
            "train",
            *command,
            f"hydra.sweep.dir={folder}",
            number=signal.SIGKILL,
            after=rng.uniform(0, whole),
        )
        assert ended.code in (0, -signal.SIGKILL)
        if not (folder / "multirun.yaml").exists():
            continue  # killed before its first job
        commands.run("train", *command, f"hydra.sweep.dir={folder}")
        for job in jobs:
            assert_same(folder / job, reference / job)
    record_property("kill -9 in a sweep: the same command ended the same", SHARE["sweep"])


def test_a_search_that_is_killed_finds_the_same(commands, rng, record_property):
    pytest.importorskip("optuna", reason="needs the extra search")
    command = ("search=dqn", "search.trials=3", *TINY)
    reference = commands.folder / "search-reference"
    whole = commands.run("search", *command, f"search.folder={reference}").seconds
    for kill in range(SHARE["search"]):
        folder = commands.folder / f"search-{kill}"
        again = (*command, f"search.folder={folder}")
        moment = rng.uniform(0, whole)
        ended = commands.kill("search", *again, number=signal.SIGKILL, after=moment)
        assert ended.code in (0, -signal.SIGKILL)
        commands.run("search", *again)
        assert rows(folder / "trials.csv") == rows(reference / "trials.csv")
        best = [json.loads((place / "best.json").read_text()) for place in (folder, reference)]
        assert best[0]["values"] == best[1]["values"]
        for trial in ("trial_0000", "trial_0001", "trial_0002"):
            table = f"{trial}/metrics.csv"
            assert rows(folder / table) == rows(reference / table)
    record_property("kill -9 in a search: the same command found the same", SHARE["search"])
