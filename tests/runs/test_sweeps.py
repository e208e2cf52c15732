"""The table at the end of a sweep."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import pytest
import yaml
from result_folders import run_result

from bbq_torchrl.evaluation.run_result import write_json
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.resume import save_config
from bbq_torchrl.runs.sweeps import table_of_runs

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.options import Config


@cache
def five_rounds() -> Config:
    return compose(["protocol.rounds=5"])


def make_run(
    folder: Path, overrides: list[str], rate: float | None = None, rounds: int = 5
) -> None:
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(overrides))
    save_config(five_rounds(), folder / "config.yaml")
    if rate is not None:
        write_json(run_result([rate], rounds=rounds), folder / "result.json")
        (folder / "curve.png").touch()


def test_a_job_that_a_signal_left_behind_has_not_begun(tmp_path):
    make_run(tmp_path / "0", ["seed=0"])
    (tmp_path / "0" / "train.log").touch()
    assert table_of_runs(tmp_path, jobs=1).splitlines()[-1].endswith("–              not begun")


def cells(line: str) -> list[str]:
    return [cell for cell in line.split("  ") if cell]


def test_every_run_is_listed_with_what_sets_it_apart(tmp_path):
    make_run(tmp_path / "10_dqn", ["agent=dqn", "seed=1", "replicas=2"], 0.7)
    make_run(tmp_path / "2_bbqn", ["agent=bbqn", "seed=1", "replicas=2"])
    make_run(tmp_path / "0_dqn", ["agent=dqn", "seed=0", "replicas=2"])
    (tmp_path / "0_dqn" / "result.json").write_text("[" * 100_000)

    title, head, *rows = table_of_runs(tmp_path, jobs=5).splitlines()

    assert title == f"1 of 5 runs in {tmp_path} are finished"
    assert [cell.strip() for cell in cells(head)] == ["run", "overrides", "final success", "state"]
    assert [[cell.strip() for cell in cells(row)] for row in rows] == [
        ["0_dqn", "agent=dqn seed=0", "–", "result.json is damaged"],
        ["2_bbqn", "agent=bbqn seed=1", "–", "not finished: train.log in it says why"],
        ["10_dqn", "agent=dqn seed=1", "0.700", "finished"],
        ["–", "–", "2 never started"],
    ]
    assert {row.index("agent") for row in rows[:3]} == {head.index("overrides")}


@pytest.mark.parametrize(
    ("overrides", "rounds", "finished", "end"),
    [
        (["agent=dqn"], 5, 1, "agent=dqn  0.500          finished"),
        ([], 5, 1, "0.500          finished"),
        (["agent=dqn"], 3, 0, "not finished: train.log in it says why"),  # it is being extended
    ],
)
def test_a_single_run_shows_all_its_overrides(tmp_path, overrides, rounds, finished, end):
    make_run(tmp_path / "0", overrides, 0.5, rounds)
    title, _, row = table_of_runs(tmp_path, jobs=0).splitlines()
    assert title.startswith(f"{finished} of 1 runs")
    assert row.endswith(end)


def test_a_sweep_of_which_nothing_started_has_a_table_too(tmp_path):
    title, _, row = table_of_runs(tmp_path, jobs=3).splitlines()
    assert title.startswith("0 of 3 runs")
    assert row.endswith("3 never started")
