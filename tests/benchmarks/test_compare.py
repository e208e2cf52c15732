"""The comparison of speeds runs, in sizes that take no time and mean nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from benchmarks import compare
from benchmarks.compare import PARTS
from benchmarks.parts import processes, updates
from benchmarks.parts.processes import Used
from benchmarks.parts.rows import Row, as_table, keep, read
from benchmarks.parts.sizes import FULL, TINY

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(autouse=True)
def commands(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """Commands are noted, not run: their imports alone take seconds."""
    asked: list[tuple[str, ...]] = []

    def python(*arguments: str) -> Used:
        asked.append(arguments)
        return Used(wall=2.0, cpu=1.0, peak_bytes=10**9)

    monkeypatch.setattr(processes, "python", python)
    return asked


SLOW = [pytest.param(part, marks=pytest.mark.slow) for part in ("agents", "time_to_learn", "floor")]


@pytest.mark.parametrize("part", ["simulator", "update", "round", *SLOW])
def test_part_gives_positive_figures(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(updates, "TARGETS", {"bbqn-map": (1.0, 1.0)})
    rows = PARTS[part](TINY)
    assert rows
    assert all(row.part == part for row in rows)
    assert all(row.measured > 0 for row in rows if row.unit != "%")


def test_the_process_part_measures_a_run_with_full_buffers_and_medians_of_starts(
    commands: list[tuple[str, ...]],
) -> None:
    memory, start = PARTS["process"](FULL)
    assert (memory.measured, memory.target, memory.reached) == (1.0, 1.5, True)
    assert {"agent=bbqn", "env=full", "replicas=5", "spike.dialogues=500"} <= set(commands[0])
    assert (start.measured, start.target) == (2.0, 6)


def test_figures_are_printed_and_kept_as_a_versions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "speed.csv"
    compare.main(["process", "--tiny", "--save=0.2.0", f"--file={file}"])
    assert "| python train.py --help | s | 2 | ≤ 6 | yes |" in capsys.readouterr().out
    assert [row.what for row in read(file)["0.2.0"]][1:] == ["python train.py --help"]


def test_rows_take_the_place_of_the_same_version_and_part(tmp_path: Path) -> None:
    file = tmp_path / "speed.csv"
    other = Row("b", "wait", "s", 3.0, 9.0, "lower", True, "1 of 5")
    keep(file, "one", [Row("a", "time", "s", 1.0), other])
    keep(file, "two", [Row("a", "turns", "turns/s", 123456.0, 100.0, "higher")])
    keep(file, "one", [Row("a", "time", "s", 2.0)])
    assert read(file) == {
        "one": [other, Row("a", "time", "s", 2.0)],
        "two": [Row("a", "turns", "turns/s", 123500.0, 100.0, "higher")],
    }


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
