"""A round's numbers: in memory, on disk, in loggers, and in a bar or the log."""

import importlib.util
import logging
import math
import multiprocessing
import sys
from unittest.mock import MagicMock, call

import pytest
import torch

from bbq_torchrl.options import schemas
from bbq_torchrl.options.logger import RunLogger
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers.recording import MetricsFile, RoundProgress

LOGGERS = schemas()["logger"]


def test_loggers_get_what_the_file_gets_but_for_what_a_round_has_not(tmp_path):
    option = MagicMock()
    logger = RunLogger(MagicMock(logger=option), tmp_path)
    metrics = MetricsFile(tmp_path / "new" / "metrics.csv", 2)
    logger.log_round(None, metrics.append(0, {"loss": [0.5, math.nan], "buffer": [3, 4]}))
    logger.log_round(None, metrics.append(1, {"loss": 0.25, "buffer": torch.tensor([5, 6])}))

    first = {"loss/replica_0": 0.5, "buffer/replica_0": 3.0, "buffer/replica_1": 4.0}
    second = {"loss/replica_0": 0.25, "buffer/replica_0": 5.0}
    second |= {"loss/replica_1": 0.25, "buffer/replica_1": 6.0}
    made = option.make.return_value
    assert option.log_round.mock_calls == [call(made, first, round=0), call(made, second, round=1)]
    table = "round,replica,loss,buffer\n0,0,0.5,3\n0,1,,4\n1,0,0.25,5\n1,1,0.25,6\n"
    assert metrics.path.read_text() == table


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


@pytest.mark.parametrize("columns", [{"loss": 0.5}, {"loss": 0.5, "epsilon": torch.zeros(3)}])
def test_columns_that_do_not_fit_are_refused_and_nothing_is_written(tmp_path, columns):
    metrics = MetricsFile(tmp_path / "metrics.csv", 2)
    rows = metrics.append(0, {"loss": 0.5, "epsilon": 1.0})
    text = metrics.path.read_text()

    with pytest.raises(ValueError, match="epsilon"):
        metrics.append(1, columns)

    assert metrics.path.read_text() == text
    assert metrics.rows == rows


@pytest.mark.parametrize("option", [LOGGERS["wandb"], LOGGERS["tensorboard"]])
def test_a_missing_package_is_named(monkeypatch, option):
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: None)

    with pytest.raises(ConfigError, match=option.package):
        option().check_ready()


def test_a_resumed_run_continues_the_same_wandb_run(tmp_path, monkeypatch):
    """With a fake package, as tests cannot reach its service."""
    stand_in = MagicMock(__spec__=importlib.util.spec_from_loader("wandb", loader=None))
    stand_in.init.side_effect = lambda **options: MagicMock(id=options["id"] or "a-new-id")
    monkeypatch.setitem(sys.modules, "wandb", stand_in)
    monkeypatch.setattr("torchrl.record.loggers.wandb._has_wandb", True)

    wandb = LOGGERS["wandb"](project="ours")
    for resume in (False, True, False):
        wandb.make(tmp_path, resume=resume)

    begun = [init.kwargs for init in stand_in.init.mock_calls]
    assert [(run["id"], run["resume"], run["project"]) for run in begun] == [
        (None, "allow", "ours"),
        ("a-new-id", "must", "ours"),
        (None, "allow", "ours"),
    ]


def row(replica, evaluated=math.nan, **changed):
    """The metrics of a round, as the progress takes them."""
    row = {"round": 0, "replica": replica, "success_rate": 0.25 + 0.5 * replica}
    row |= {"reward": -10.0 + 4 * replica, "kl": 100.0, "seconds": 2.0}
    return {**row, "eval_success_rate": evaluated, **changed}


def test_the_bar_shows_means_over_the_replicas_and_the_last_evaluation(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "200")  # of a fast machine, the rate alone has many digits
    bar = RoundProgress(10, done=4)
    for evaluated in (math.nan, 0.5, math.nan):
        bar.update([row(0, evaluated), row(1, evaluated)])
    bar.close()

    shown = capsys.readouterr()
    assert shown.out == ""
    assert "nan" not in shown.err
    last = shown.err.split("\r")[-1]
    for part in ("7/10", "success=0.50", "reward=-8.0", "eval=0.50"):
        assert part in last


def test_runs_side_by_side_do_not_draw_over_one_another(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for parent, is_shown in ((None, True), (object(), False)):
        monkeypatch.setattr(multiprocessing, "parent_process", lambda parent=parent: parent)
        RoundProgress(2).close()
        assert bool(capsys.readouterr().err) is is_shown


def test_a_long_training_logs_at_most_forty_lines_with_means_of_the_rounds_between(caplog):
    caplog.set_level(logging.INFO, "bbq_torchrl")
    progress = RoundProgress(82, name="a_run")
    for number in range(82):
        evaluated = {3: 0.1, 4: 0.2}.get(number, math.nan)
        progress.update([row(0, evaluated, success_rate=(number % 3) / 2)])
    said = caplog.messages
    assert len(said) == 28  # after every third round, and after the last
    # Rounds 1 to 3 have 0, .5 and 1; the last evaluation, of round 5, is in the line after round 6.
    assert said[0] == "a_run: round 3 of 82: success 0.50, reward -10.0, 2.0 s a round"
    assert "round 6 of 82: success 0.50, evaluation 0.20, reward" in said[1]
    assert "round 82 of 82: success 0.00" in said[-1]
