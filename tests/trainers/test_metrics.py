"""metrics.csv in memory and on disk."""

from __future__ import annotations

import math

import pytest

from bbq_torchrl.trainers import MetricsFile


def rows(round_number: int) -> list[dict[str, int | float]]:
    return [
        {"round": round_number, "replica": r, "loss": 0.1 * (round_number + r), "kl": math.pi}
        for r in range(2)
    ]


def test_rows_are_appended_below_one_header(tmp_path):
    metrics = MetricsFile(tmp_path / "new" / "metrics.csv")

    for number in range(3):
        metrics.append(rows(number))

    lines = metrics.path.read_text().splitlines()
    assert lines[0] == "round,replica,loss,kl"
    assert len(lines) == 7
    assert lines[3] == f"1,0,0.1,{math.pi}"


def test_a_restored_file_is_as_it_was_whatever_lies_there(tmp_path):
    metrics = MetricsFile(tmp_path / "metrics.csv")
    metrics.append(rows(0))
    metrics.append(rows(1))
    state, text = metrics.state_dict(), metrics.path.read_text()
    metrics.append(rows(2))
    metrics.path.write_text(metrics.path.read_text()[:-7])

    other = MetricsFile(tmp_path / "metrics.csv")
    other.load_state_dict(state)

    assert other.path.read_text() == text
    assert other.rows == [*rows(0), *rows(1)]
    assert [type(v) for v in other.rows[0].values()] == [int, int, float, float]
    other.append(rows(2))
    assert other.path.read_text().startswith(text)
    assert len(other.path.read_text().splitlines()) == 7


def test_restoring_no_rows_removes_the_file(tmp_path):
    metrics = MetricsFile(tmp_path / "metrics.csv")
    empty = metrics.state_dict()
    metrics.append(rows(0))

    metrics.load_state_dict(empty)

    assert not metrics.path.exists()
    assert metrics.rows == []


def test_what_a_round_has_not_is_empty_and_survives(tmp_path):
    metrics = MetricsFile(tmp_path / "metrics.csv")
    metrics.append([{"round": 0, "replica": 0, "loss": math.nan, "kl": math.inf}])

    metrics.load_state_dict(metrics.state_dict())

    assert metrics.path.read_text().splitlines()[1] == "0,0,,inf"
    assert math.isnan(metrics.rows[0]["loss"])


def test_other_columns_are_refused_and_nothing_is_written(tmp_path):
    metrics = MetricsFile(tmp_path / "metrics.csv")
    metrics.append(rows(0))
    text = metrics.path.read_text()

    with pytest.raises(ValueError, match=r"must have the columns \('round', .*'kl'\)"):
        metrics.append([{"round": 1, "replica": 0}])

    assert metrics.path.read_text() == text
    assert metrics.rows == rows(0)
