"""Trainings killed repeatedly at any moment end like undisturbed ones."""

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
    reference, kills = references(name), 0
    while kills < SHARE[name]:
        folder = commands.folder / f"{name}-{kills}"
        new = (*reference.overrides, f"hydra.run.dir={folder}")
        for _ in range(2):
            moment = {"number": signal.SIGKILL, "after": rng.uniform(0, reference.seconds)}
            ended = commands.kill("train", *go_on(folder, new), **moment)
            kills += ended.code == -signal.SIGKILL
        ended = commands.start("train", *go_on(folder, new)).end()
        assert ended.code == 0 or "is finished" in ended.line
        assert_same(folder, reference.folder)
    record_property("kill -9 in a training: resumed to the same, bit for bit", kills)


SWEEP = ("train", "--multirun", "hydra/launcher=basic", "agent=dqn,bbqn", *TINY)
SEARCH = ("search", "search=dqn", "search.trials=3", *TINY)


@pytest.mark.parametrize(
    ("kind", "command", "place", "tables"),
    [
        ("sweep", SWEEP, "hydra.sweep.dir", 2),
        ("search", SEARCH, "search.folder", 4),  # of three trials, and of the search
    ],
)
def test_a_sweep_or_search_that_is_killed_ends_the_same(
    commands, rng, record_property, kind, command, place, tables
):
    pytest.importorskip("optuna", reason="needs the extra search")
    reference = commands.folder / kind
    whole = commands.run(*command, f"{place}={reference}").seconds
    found = [file.relative_to(reference) for file in reference.rglob("*.csv")]
    assert len(found) == tables
    for kill in range(SHARE[kind]):
        folder = commands.folder / f"{kind}-{kill}"
        again = (*command, f"{place}={folder}")
        ended = commands.kill(*again, number=signal.SIGKILL, after=rng.uniform(0, whole))
        assert ended.code in (0, -signal.SIGKILL)
        commands.run(*again)
        for table in found:
            assert rows(folder / table) == rows(reference / table)
    record_property(f"kill -9 in a {kind}: the same command ended the same", SHARE[kind])
