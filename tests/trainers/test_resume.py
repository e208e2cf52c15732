"""A training that is killed and resumed ends as one that was not, bit for bit."""

from __future__ import annotations

import csv
import json
import logging
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import killable
import pytest
import torch
from trainer_parts import make_trainer

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.trainers import RoundTrainer


class Processes:
    """Runs trainings in processes that may die."""

    def __init__(self) -> None:
        self._server = subprocess.Popen(
            [sys.executable, killable.__file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, folder: Path, moment: str | None = None) -> int:
        """Returns the exit code: 0, or the negative number of the signal that ended it."""
        request = {"folder": str(folder), "moment": moment}
        self._server.stdin.write(json.dumps(request) + "\n")
        self._server.stdin.flush()
        for line in self._server.stdout:
            if line.startswith("exit "):
                return int(line.split()[1])
        raise RuntimeError("the server of processes is gone")

    def close(self) -> None:
        self._server.stdin.close()
        self._server.wait()
        self._server.stdout.close()


@pytest.fixture(scope="module")
def processes():
    server = Processes()
    yield server
    server.close()


def finished(folder: Path) -> RoundTrainer:
    """Returns the trainer of a finished training, its state loaded from the last checkpoint."""
    trainer = killable.build(folder)
    trainer.train(resume=True)
    return trainer


def table(folder: Path) -> list[dict[str, str]]:
    """metrics.csv without its seconds."""
    with (folder / "metrics.csv").open(newline="") as file:
        return [
            {name: value for name, value in row.items() if not name.startswith("seconds")}
            for row in csv.DictReader(file)
        ]


def assert_same_training(folder: Path, reference: RoundTrainer) -> None:
    ours, expected = finished(folder), reference
    assert ours.rounds_done == expected.rounds_done == killable.ROUNDS
    assert table(folder) == table(reference.run_folder)
    for part in ("loss", "policy", "optimizer", "replay"):
        ours_state, expected_state = (getattr(t, part).state_dict() for t in (ours, expected))
        assert_equal(ours_state, expected_state, part)


def assert_equal(ours: object, expected: object, where: str) -> None:
    if isinstance(expected, torch.Tensor):
        assert torch.equal(ours, expected), where
    elif isinstance(expected, dict):
        assert ours.keys() == expected.keys(), where
        for name, value in expected.items():
            assert_equal(ours[name], value, f"{where}.{name}")
    elif isinstance(expected, list | tuple):
        for number, pair in enumerate(zip(ours, expected, strict=True)):
            assert_equal(*pair, f"{where}[{number}]")
    else:
        assert ours == expected, where


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> RoundTrainer:
    """A training that was never interrupted."""
    trainer = killable.build(tmp_path_factory.mktemp("reference") / "run")
    rows = trainer.train()
    # The comparison means something only if the state that is carried over is a rich one: ragged
    # buffers, and a spike that was dropped on the way.
    assert len({row["buffer"] for row in rows[-2:]}) == 2
    assert 0 in trainer.replay.protected
    return trainer


@pytest.mark.parametrize("moment", [*killable.MOMENTS, "within a line of the metrics"])
def test_a_training_killed_at_the_worst_moment_ends_the_same(
    tmp_path, processes, reference, moment
):
    folder = tmp_path / "run"

    assert processes.run(folder, moment) == -signal.SIGKILL
    assert processes.run(folder) == 0

    assert_same_training(folder, reference)
    assert not [path for path in (folder / "checkpoint").iterdir() if path.name.startswith(".")]


def test_a_training_can_be_resumed_for_more_rounds(tmp_path):
    make_trainer(tmp_path / "long", rounds=6).train()
    make_trainer(tmp_path / "short", rounds=3).train()

    make_trainer(tmp_path / "short", rounds=6).train(resume=True)

    assert table(tmp_path / "short") == table(tmp_path / "long")


def test_a_damaged_newest_checkpoint_costs_rounds_but_not_the_result(tmp_path, reference, caplog):
    folder = tmp_path / "run"
    killable.build(folder).train()
    newest = max((folder / "checkpoint").iterdir())
    newest.write_bytes(newest.read_bytes()[:1000])

    with caplog.at_level(logging.WARNING, "bbq_torchrl"):
        resumed = killable.build(folder)
        resumed.train(resume=True)

    assert newest.name in caplog.text
    assert_same_training(folder, reference)
