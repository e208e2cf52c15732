"""TorchRL's loggers in a run folder."""

from __future__ import annotations

import importlib.util
import sys
from unittest.mock import MagicMock

import pytest
from trainer_parts import make_trainer

from bbq_torchrl.options import ConfigError, LoggerOption, schemas


def options():
    return schemas()["logger"]


def test_csv_is_metrics_csv_alone(tmp_path):
    make_trainer(tmp_path, rounds=1, loggers=options()["csv"]().make(tmp_path)).train()

    assert {path.name for path in tmp_path.iterdir()} == {"checkpoint", "metrics.csv"}


def test_tensorboard_reads_the_metrics_back(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (logger,) = options()["tensorboard"]().make(tmp_path)
    rows = make_trainer(tmp_path, rounds=3, loggers=[logger]).train()
    logger.experiment.close()

    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    for replica in range(3):
        scalars = events.Scalars(f"reward/replica_{replica}")
        assert [s.step for s in scalars] == [0, 1, 2]
        expected = [row["reward"] for row in rows[replica::3]]
        assert [s.value for s in scalars] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", ["tensorboard", "wandb", "mlflow"])
def test_a_missing_package_is_named_with_its_extra(monkeypatch, name):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda module: None if module == name else find(module)
    )

    with pytest.raises(ConfigError, match=rf"needs the package {name}: pip install .*\[{name}\]'"):
        options()[name]().check_package()


def test_a_missing_package_of_a_logger_of_ones_own_is_named_without_an_extra():
    class Own(LoggerOption):
        name = "own"
        package = "not_installed_anywhere"
        make = None

    with pytest.raises(ConfigError, match=r": pip install not_installed_anywhere$"):
        Own().check_package()


def test_a_resumed_run_goes_on_as_the_same_wandb_run(tmp_path, monkeypatch):
    """With a stand-in for the package: its service is out of a test's reach."""
    begun: list[dict] = []

    def init(**options: object) -> MagicMock:
        begun.append(options)
        return MagicMock(id=options["id"] or "a-new-id")

    stand_in = MagicMock(init=init, __spec__=importlib.util.spec_from_loader("wandb", loader=None))
    monkeypatch.setitem(sys.modules, "wandb", stand_in)
    monkeypatch.setattr("torchrl.record.loggers.wandb._has_wandb", True)

    wandb = options()["wandb"](project="ours")
    wandb.make(tmp_path)
    wandb.make(tmp_path, resume=True)
    wandb.make(tmp_path)

    assert [run["id"] for run in begun] == [None, "a-new-id", None]
    assert [run["resume"] for run in begun] == ["allow", "must", "allow"]
    assert all(run["project"] == "ours" for run in begun)
