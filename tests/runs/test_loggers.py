"""Several logged runs in one process stay separate, each with configuration, rounds and result."""

import json
import os
import struct
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar
from unittest.mock import MagicMock

import forked
import pytest
from own_options import own_options
from tiny import TINY, composed, nightly, rows

from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.runs.train import main, run
from bbq_torchrl.settings import ConfigError, option

RUN = ["agent=dqn", *TINY, "replicas=2"]


@dataclass
class Logged:
    """A run as a logger has it: its configuration, its rounds by number, and its result."""

    config: dict = field(default_factory=dict)
    rounds: dict = field(default_factory=dict)
    result: dict = field(default_factory=dict)
    state: str = ""

    def take(self, key, step, value):
        if key.startswith("result/"):
            self.result[key] = value
        else:
            self.rounds.setdefault(step, {})[key] = value


RECORDED = {}

pytestmark = pytest.mark.usefixtures("without_curves")


@dataclass
class Own(LoggerOption):
    """A logger of one's own, which fails in some of its methods."""

    name: str = option("own")
    fails: ClassVar = ()

    def make(self, run_folder, *, resume=False):
        failing = {f"{method}.side_effect": fail for method in self.fails}
        RECORDED[run_folder] = MagicMock(**failing)
        return RECORDED[run_folder]

    def close(self, logger, *, finished):
        super().close(logger, finished=finished)
        logger.state = "finished" if finished else "failed"


@pytest.fixture(autouse=True)
def _own_logger():
    with own_options():
        register(Own)
        yield


def of_tensorboard(folder):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (file,) = (folder / "tensorboard").iterdir()
    events = EventAccumulator(str(file)).Reload()
    (text,) = events.Tensors("config/text_summary")
    lines = text.tensor_proto.string_val[0].decode().splitlines()
    logged = Logged(dict(line.strip().split(": ", 1) for line in lines))
    for tag in events.Tags()["scalars"]:
        for event in events.Scalars(tag):
            logged.take(tag, event.step, event.value)
    return logged


def check(folder, logged, seed):
    """A logger has of a run what its folder has, and nothing of another one's."""
    assert str(logged.config["seed"]) == str(seed)
    assert str(logged.config["agent.hidden"]).replace(" ", "") == "[8,8]"
    assert "resume" not in logged.config
    table = rows(folder / "metrics.csv")
    assert sorted(logged.rounds) == [0, 1]
    for row in table:
        values = logged.rounds[int(row.pop("round"))]
        replica = row.pop("replica")
        found = {key: values[f"{key}/replica_{replica}"] for key, value in row.items() if value}
        given = {key: float(value) for key, value in row.items() if value}
        assert found == pytest.approx(given, rel=1e-6)
    result = read_result(folder)
    for name in ("success_rate", "reward", "training_success"):
        assert logged.result[f"result/{name}"] == pytest.approx(getattr(result, name), rel=1e-6)
        of_one = getattr(result.per_replica[1], name)
        assert logged.result[f"result/{name}/replica_1"] == pytest.approx(of_one, rel=1e-6)
    assert logged.result["result/scripted/random"] == pytest.approx(result.scripted["random"])
    assert logged.result["result/while_training/last"] == pytest.approx(result.while_training.last)


def test_two_runs_of_a_process_are_two_of_the_logger(tmp_path):
    for seed in (0, 1):
        folder = tmp_path / f"seed{seed}"
        run(replace(composed(*RUN, "logger=tensorboard"), seed=seed), folder)
        check(folder, of_tensorboard(folder), seed)


def fail(*_, **__):
    raise RuntimeError("no answer from http://me:secret@host")


@pytest.mark.parametrize(("callbacks", "state"), [([], "finished"), ([fail], "failed")])
def test_a_logger_is_told_the_configuration_and_how_its_run_ended(callbacks, state, tmp_path):
    with suppress(RuntimeError):
        run(composed(*RUN, "logger=own"), tmp_path, callbacks)
    logger = RECORDED[tmp_path]
    assert logger.log_hparams.call_args.args[0]["agent.hidden"] == [8, 8]
    logger.close.assert_called_once_with()
    assert logger.state == state


@pytest.mark.parametrize("fails", nightly(["log_hparams", "log_metrics", "close"], ["log_metrics"]))
def test_a_logger_that_fails_is_given_up_with_one_warning(fails, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(Own, "fails", (fails,))
    run(composed(*RUN, "logger=own"), tmp_path / "run")
    assert len(rows(tmp_path / "run" / "metrics.csv")) == 4
    assert read_result(tmp_path / "run").rounds == 2
    (warning,) = [line for line in caplog.messages if "logger=own" in line]
    assert "http://me:***@host" in warning


def test_a_logger_that_cannot_begin_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(Own, "make", fail)
    with pytest.raises(ConfigError, match="logger=own"):
        run(composed(*RUN, "logger=own"), tmp_path / "run")


# ------------------------------------------------------------------ the real packages


def of_wandb(folder):
    """Reads the file of an offline run: a log of protocol buffers in blocks of 32 KiB."""
    from wandb.proto import wandb_internal_pb2 as protocol

    (file,) = (folder / "wandb").glob("offline-run-*/*.wandb")
    data, at, part, logged = file.read_bytes(), 7, b"", Logged()
    while at + 7 <= len(data):
        if (left := 32_768 - at % 32_768) < 7:
            at += left
            continue
        _, length, kind = struct.unpack_from("<IHB", data, at)
        part += data[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # whole, or the last part
            record = protocol.Record.FromString(part)
            part = b""
            _take(record, logged)
    return logged


def _take(record, logged):
    def values(items):
        return {
            "/".join(item.nested_key) or item.key: json.loads(item.value_json) for item in items
        }

    kind = record.WhichOneof("record_type")
    if kind == "config":
        logged.config |= values(record.config.update)
    elif kind == "history":
        row = values(record.history.item)
        assert not any(key.endswith("/step") for key in row)  # a second chart of each
        logged.rounds[row["round"]] = row
    elif kind == "summary":
        logged.result |= values(record.summary.update)
    elif kind == "exit":
        logged.state = "failed" if record.exit.exit_code else "finished"


def of_mlflow(folder):
    from mlflow import MlflowClient

    from bbq_torchrl.utils.output import sqlite_url

    client = MlflowClient(os.environ.get("MLFLOW_TRACKING_URI") or sqlite_url(folder / "mlflow.db"))
    (experiment,) = client.search_experiments(filter_string="name = 'bbq-torchrl'")
    found = client.search_runs([experiment.experiment_id])
    (ours,) = [item for item in found if item.info.run_name == folder.name]
    logged = Logged(dict(ours.data.params), state=ours.info.status.lower())
    for key in ours.data.metrics:
        for entry in client.get_metric_history(ours.info.run_id, key):
            logged.take(key, entry.step, entry.value)
    return logged


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "address", "way"),
    [
        ("mlflow", {"MLFLOW_TRACKING_URI": "http://me:secret@127.0.0.1:9"}, []),
        ("mlflow", {"MLFLOW_TRACKING_URI": "./mlruns"}, ["--multirun", "seed=1,2"]),
        ("mlflow", {"MLFLOW_TRACKING_URI": "mysql+nodriver://me:secret@127.0.0.1/runs"}, []),
        ("wandb", {"WANDB_MODE": "online"}, []),
    ],
)
def test_a_logger_that_cannot_be_reached_is_refused_before_a_folder_is_there(
    name, address, way, tmp_path, monkeypatch
):
    pytest.importorskip(name)  # here, and not in every child
    for key in ("MLFLOW_TRACKING_URI", "WANDB_API_KEY", "WANDB_MODE"):
        monkeypatch.delenv(key, raising=False)
    alone = {"HOME": str(tmp_path), "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0"}
    for key, value in (alone | address).items():
        monkeypatch.setenv(key, value)
    _, error = forked.call(main, *way, *RUN, f"logger={name}", cwd=tmp_path, code=2)
    assert error.splitlines()[-1].startswith(f"error: logger={name} cannot be used: ")
    assert "Traceback" not in error
    assert "secret" not in error
    assert not (tmp_path / "runs").exists()


def sweep(name, folder):
    """Three jobs in one process, the first of which fails. Returns the folders of the jobs."""
    # W&B's service ends as the interpreter exits, which a forked child does not.
    of_its_own = partial(forked.python, forked.ROOT / "train.py")
    train = of_its_own if name == "wandb" else partial(forked.call, main)
    train(
        *("--multirun", "hydra/launcher=basic", *RUN, f"logger={name}"),
        *("agent.lr=1e30,.001,.002", f"hydra.sweep.dir='{folder}'"),
        *("hydra.sweep.subdir='job_${hydra.job.num}'", "seed=7"),
        cwd=folder.parent,
        code=1,
    )
    return [folder / f"job_{number}" for number in range(3)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")  # MLflow's
@pytest.mark.parametrize(
    ("name", "read", "given"),
    [
        ("wandb", of_wandb, {"WANDB_MODE": "offline"}),
        ("mlflow", of_mlflow, {}),
        ("mlflow", of_mlflow, {"MLFLOW_TRACKING_URI": "sqlite:///{folder}/shared.db"}),
    ],
)
def test_each_job_of_a_process_is_a_run_of_the_real_package(
    name, read, given, tmp_path, monkeypatch
):
    pytest.importorskip(name)  # here, and not in every child
    for key in ("MLFLOW_TRACKING_URI", *given):
        monkeypatch.delenv(key, raising=False)
    for key, value in given.items():
        monkeypatch.setenv(key, value.format(folder=tmp_path))
    # A path with what has a meaning in an address.
    failed, *finished = sweep(name, tmp_path / ("sweep" if given else "a%23b#c?d {e} é"))
    assert read(failed).state == "failed"
    for folder, lr in zip(finished, (0.001, 0.002), strict=True):
        logged = read(folder)
        check(folder, logged, 7)
        assert float(logged.config["agent.lr"]) == lr
        assert logged.state == "finished"
    assert len(list(tmp_path.iterdir())) == 1 + ("MLFLOW_TRACKING_URI" in given)
