"""result.json and metrics.csv are read as they were written, or refused by name."""

import dataclasses
import math

import numpy as np
import pytest
from result_folders import metrics_text, run_result

from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.evaluation.run_result import (
    read_result,
    replica_result,
    training_evaluation,
    write_json,
)


def test_a_run_is_the_mean_of_its_replicas_and_they_of_their_dialogues():
    found = replica_result(2, [1, 0, 0, 1], [32, -13, -15, 30], [9, 4, 6, 11], training_success=0.3)
    assert (found.replica, found.success_rate, found.reward, found.turns) == (2, 0.5, 8.5, 7.5)
    assert (found.dialogues, found.training_success, found.standard_error) == (4, 0.3, 0.25)
    result = run_result([0.2, 0.4, 0.9])
    assert result.success_rate == pytest.approx(0.5)
    assert result.training_success == pytest.approx(0.25)
    assert (result.replicas, result.dialogues, result.reward, result.turns) == (3, 300, 10, 8)
    variances = [rate * (1 - rate) / 100 for rate in (0.2, 0.4, 0.9)]
    assert result.standard_error == pytest.approx(math.sqrt(sum(variances)) / 3)


def test_a_result_is_read_as_it_was_written(tmp_path):
    base = run_result([0.4, 0.2], scripted={"rule": 0.18})
    replicas = [
        dataclasses.replace(
            entry, while_training=training_evaluation([0.2, rate], best=rate, best_round=1 - number)
        )
        for number, (entry, rate) in enumerate(zip(base.per_replica, (0.4, 0.2), strict=True))
    ]
    result = dataclasses.replace(base, per_replica=tuple(replicas)).only([0, 1])
    assert result.while_training.last == pytest.approx(0.3)
    assert result.while_training.best_round == 0.5
    assert result.only([1]).while_training == replicas[1].while_training
    write_json(result, tmp_path / "result.json")
    assert read_result(tmp_path) == result
    assert [file.name for file in tmp_path.iterdir()] == ["result.json"]
    # One replica that has none: no mean either.
    mixed = (base.per_replica[0], replicas[1])
    assert dataclasses.replace(base, per_replica=mixed).only([0, 1]).while_training is None


@pytest.fixture
def read(tmp_path):
    """Reads metrics with this text."""

    def read_text(text):
        (tmp_path / "metrics.csv").write_text(text)
        return read_metrics(tmp_path)

    return read_text


def test_metrics_are_arrays_of_rounds_and_replicas_without_a_round_that_a_kill_tore(read):
    text = metrics_text([0.2, 0.6], rounds=3)
    for kept, rounds in (
        (text, 3),
        (text[:-4], 2),
        ("".join(text.splitlines(keepends=True)[:-1]), 2),
    ):
        metrics = read(kept)
        assert (metrics.rounds, metrics.replicas) == (rounds, 2)
        assert metrics["success_rate"] == pytest.approx(np.array([[0.1, 0.3]] * rounds))
        assert metrics["round"][:, 0].tolist() == list(range(rounds))


def test_training_success_counts_dialogues_and_what_a_round_has_not_is_nan(read):
    head = "round,replica,dialogues,success_rate,eval_success_rate\n"
    metrics = read(f"{head}0,0,10,.5,\n1,0,30,.9,.25\n")
    assert metrics.training_success == pytest.approx([(5 + 27) / 40])
    assert metrics["eval_success_rate"][:, 0].tolist() == pytest.approx(
        [math.nan, 0.25], nan_ok=True
    )
