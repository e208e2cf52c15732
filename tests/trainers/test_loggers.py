"""TorchRL's loggers in a run folder."""

from __future__ import annotations

import importlib.util
import sys
from unittest.mock import MagicMock

import pytest
from trainer_parts import make_trainer

from bbq_torchrl.trainers import make_loggers
from bbq_torchrl.trainers.loggers import trim_scalars


def test_csv_scalars_are_the_metrics(tmp_path):
    trainer = make_trainer(tmp_path, rounds=3, loggers=make_loggers(["csv"], tmp_path))

    rows = trainer.train()

    for replica in range(3):
        for name in ("success_rate", "loss", "buffer"):
            lines = (tmp_path / "scalars" / name / f"replica_{replica}.csv").read_text().split()
            assert lines == [f"{r['round']},{float(r[name])}" for r in rows[replica::3]]
    assert not (tmp_path / "videos").exists()
    assert not (tmp_path / "texts").exists()


def test_csv_is_always_among_them_and_each_is_made_once(tmp_path):
    assert [type(logger).__name__ for logger in make_loggers([], tmp_path)] == ["CSVLogger"]
    names = [type(lg).__name__ for lg in make_loggers(["tensorboard", "csv", "csv"], tmp_path)]
    assert names == ["CSVLogger", "TensorboardLogger"]


def test_tensorboard_reads_the_metrics_back(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    trainer = make_trainer(tmp_path, rounds=3, loggers=make_loggers(["tensorboard"], tmp_path))
    rows = trainer.train()
    trainer.loggers[1].experiment.close()

    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    for replica in range(3):
        scalars = events.Scalars(f"reward/replica_{replica}")
        assert [s.step for s in scalars] == [0, 1, 2]
        expected = [row["reward"] for row in rows[replica::3]]
        assert [s.value for s in scalars] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", ["tensorboard", "wandb", "mlflow"])
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, name):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda module: None if module == name else find(module)
    )

    with pytest.raises(ImportError, match=rf"needs the package {name}: pip install .*\[{name}\]'"):
        make_loggers([name], tmp_path / "run")

    assert not (tmp_path / "run").exists()


def test_an_unknown_logger_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"one of \['csv', 'tensorboard', 'wandb', 'mlflow'\]"):
        make_loggers(["comet"], tmp_path)


def test_a_resumed_run_goes_on_as_the_same_wandb_run(tmp_path, monkeypatch):
    """With a stand-in for the package: its service is out of a test's reach."""
    begun: list[dict] = []

    def init(**options: object) -> MagicMock:
        begun.append(options)
        return MagicMock(id=options["id"] or "a-new-id")

    stand_in = MagicMock(init=init, __spec__=importlib.util.spec_from_loader("wandb", loader=None))
    monkeypatch.setitem(sys.modules, "wandb", stand_in)
    monkeypatch.setattr("torchrl.record.loggers.wandb._has_wandb", True)

    make_loggers(["wandb"], tmp_path)
    make_loggers(["wandb"], tmp_path, resume=True)
    make_loggers(["wandb"], tmp_path)

    assert [run["id"] for run in begun] == [None, "a-new-id", None]
    assert [run["resume"] for run in begun] == ["allow", "must", "allow"]
    assert all(run["project"] == "bbq-torchrl" for run in begun)


def test_wandb_takes_the_metrics(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")

    trainer = make_trainer(tmp_path, rounds=2, loggers=make_loggers(["wandb"], tmp_path))
    rows = trainer.train()
    summary = dict(trainer.loggers[1].experiment.summary)
    trainer.loggers[1].experiment.finish()

    assert summary["reward/replica_2"] == rows[-1]["reward"]
    assert list((tmp_path / "wandb").glob("offline-run-*/*.wandb"))


def test_mlflow_takes_the_metrics(tmp_path):
    mlflow = pytest.importorskip("mlflow")

    trainer = make_trainer(tmp_path, rounds=2, loggers=make_loggers(["mlflow"], tmp_path))
    rows = trainer.train()
    run_id = mlflow.active_run().info.run_id
    mlflow.end_run()

    client = mlflow.MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}")
    history = client.get_metric_history(run_id, "reward/replica_1")
    assert [point.step for point in history] == [0, 1]
    assert [point.value for point in history] == [row["reward"] for row in rows[1::3]]


def test_trimming_keeps_earlier_rounds_and_whole_lines(tmp_path):
    folder = tmp_path / "scalars" / "loss"
    folder.mkdir(parents=True)
    whole = "0,1.5\n1,1.25\n2,1.0\n3,0.5\n"
    (folder / "replica_0.csv").write_text(whole)
    (folder / "replica_1.csv").write_text("0,1.5\n1,1.2")

    trim_scalars(tmp_path, 2)

    assert (folder / "replica_0.csv").read_text() == "0,1.5\n1,1.25\n"
    assert (folder / "replica_1.csv").read_text() == "0,1.5\n"


def test_trimming_a_run_without_scalars_does_nothing(tmp_path):
    trim_scalars(tmp_path, 2)

    assert list(tmp_path.iterdir()) == []
