"""The comparison of speeds runs, in sizes that take no time and mean nothing."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from benchmarks import compare
from benchmarks.parts import comparisons, processes
from benchmarks.parts.comparisons import PARTS
from benchmarks.parts.processes import Used
from benchmarks.parts.rows import Row, as_table
from benchmarks.parts.sizes import FULL, TINY
from benchmarks.parts.timing import Timer

IN_THIS_PROCESS = ("simulator", "update", "bootstrap", "run", "evaluation")
SLOW = ("replicas", "vime", "time_to_learn")


@pytest.fixture(autouse=True)
def no_processes(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """Commands are noted, not run: their imports alone take seconds."""
    asked: list[tuple[str, ...]] = []

    def python(*arguments: str) -> Used:
        asked.append(arguments)
        return Used(wall=2.0, cpu=1.0, peak_bytes=10**9)

    monkeypatch.setattr(processes, "python", python)
    return asked


@pytest.mark.parametrize(
    "part", [*IN_THIS_PROCESS, *(pytest.param(part, marks=pytest.mark.slow) for part in SLOW)]
)
def test_part_gives_positive_figures(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparisons, "PAPER", ("bbqn-map",))
    rows = PARTS[part](TINY, Timer())
    assert rows
    assert all(row.part == part for row in rows)
    assert all(row.measured > 0 for row in rows if row.unit != "%")


def test_every_target_is_in_the_full_comparison() -> None:
    assert set(PARTS) >= {*IN_THIS_PROCESS, *SLOW, "agents", "memory", "start"}
    assert FULL.dialogues == (50, 1_000, 16_384)
    assert FULL.many == 10
    assert FULL.capacity == 10_000


def test_memory_is_that_of_a_run_with_full_buffers(no_processes: list[tuple[str, ...]]) -> None:
    (row,) = PARTS["memory"](FULL, Timer())
    assert (row.measured, row.target, row.reached) == (1.0, 1.5, True)
    (command,) = no_processes
    assert {"agent=bbqn", "env=full", "replicas=5", "spike.dialogues=500"} <= set(command)


def test_start_is_the_median_of_processes() -> None:
    rows = PARTS["start"](replace(FULL, repeats=3), Timer())
    assert [row.measured for row in rows] == [2.0] * len(rows)
    assert rows[0].target == 6


def test_json_is_all_that_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    compare.main(["start", "--tiny", "--json"])
    (row,) = json.loads(capsys.readouterr().out)
    assert row["what"] == "python train.py --help"
    assert row["reached"] is True


def test_table_says_what_is_reached() -> None:
    rows = [
        Row("a", "bound", "s", 1.0, 2.0, is_bound=True, remark="1 of 5"),
        Row("a", "speed", "turns/s", 99.0, 100.0, "higher"),
        Row("a", "time", "s", 1.0, 1.0),
        Row("a", "other", "ms", 3.14159),
    ]
    lines = [line.strip("| ").split(" | ") for line in as_table(rows).splitlines()[2:]]
    assert lines == [
        ["bound (1 of 5)", "s", "> 1", "≤ 2", "no"],
        ["speed", "turns/s", "99", "≥ 100", "no"],
        ["time", "s", "1", "≤ 1", "yes"],
        ["other", "ms", "3.14", "–", "–"],
    ]
