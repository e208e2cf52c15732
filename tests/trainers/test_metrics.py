"""A round's metrics in memory, on disk and in loggers."""

from __future__ import annotations

import math

import pytest
import torch

from bbq_torchrl.trainers import MetricsFile, TrainingError


def columns(round_number: int) -> dict[str, object]:
    loss = [0.1 * (round_number + r) for r in range(2)]
    return {"buffer": torch.tensor([7, 9]), "loss": loss, "kl": math.pi}


def test_loggers_get_what_the_file_gets_but_for_what_a_round_has_not(tmp_path):
    logged = []

    class Logger:
        def log_scalar(self, name, value, step):
            logged.append((name, value, step))

    metrics = MetricsFile(tmp_path / "new" / "metrics.csv", 2, [Logger()])
    metrics.append(0, {"loss": [0.5, math.nan], "buffer": [3, 4]})
    metrics.append(1, {"loss": [0.25, 0.75], "buffer": [5, 6]})

    assert logged == [
        *(("loss/replica_0", 0.5, 0), ("buffer/replica_0", 3.0, 0), ("buffer/replica_1", 4.0, 0)),
        *(("loss/replica_0", 0.25, 1), ("buffer/replica_0", 5.0, 1)),
        *(("loss/replica_1", 0.75, 1), ("buffer/replica_1", 6.0, 1)),
    ]


def test_what_a_round_has_not_is_empty_and_without_rounds_there_is_no_file(tmp_path):
    metrics = MetricsFile(tmp_path / "metrics.csv", 1)
    empty = metrics.state_dict()
    metrics.append(0, {"loss": math.nan, "kl": math.inf})

    metrics.load_state_dict(metrics.state_dict())

    assert metrics.path.read_text().splitlines()[1] == "0,0,,inf"
    assert math.isnan(metrics.rows[0]["loss"])
    metrics.load_state_dict(empty)
    assert not metrics.path.exists()
    assert metrics.rows == []


def test_other_columns_are_refused_and_nothing_is_written(tmp_path):
    metrics = MetricsFile(tmp_path / "metrics.csv", 2)
    rows = metrics.append(0, columns(0))
    text = metrics.path.read_text()

    with pytest.raises(ValueError, match=r"must have the columns \('round', .*'kl'\)"):
        metrics.append(1, {"loss": 0.5})

    assert metrics.path.read_text() == text
    assert metrics.rows == rows


@pytest.mark.parametrize("shape", [(3,), (2, 1)])
def test_a_metric_of_another_shape_is_named(shape, tmp_path):
    metrics = MetricsFile(tmp_path / "metrics.csv", 2)
    with pytest.raises(
        TrainingError,
        match=r"^the metric epsilon must be one number or one for each replica, shape \[2\], "
        rf"got shape \[{', '.join(map(str, shape))}\]$",
    ):
        metrics.append(0, {"loss": 0.5, "epsilon": torch.zeros(shape)})
