"""A run that is killed and resumed ends like an uninterrupted one, bit for bit."""

import os
import signal
import zipfile
from itertools import count
from operator import attrgetter

import forked
import pytest
import torch
from tiny import nightly, rows
from trainer_parts import make_trainer, random_policy

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.trainers import ReplicaAdam, Spike, checkpoint
from bbq_torchrl.trainers.recording import MetricsFile

# Where a process dies: the function, and which of its calls. Rounds 2, 4, ... save a checkpoint of
# five parts, the first one is saved right after the spike (one call of extend).
MOMENTS = {
    "while the buffer is spiked": (ReplicaReplay, "extend", 1),
    "before the first checkpoint is published": (os, "replace", 1),
    "in the middle of an epoch": (ReplicaAdam, "step", 70),
    "while a checkpoint is written": (zipfile.ZipFile, "write", 10),
    "before a checkpoint is published": (os, "replace", 3),
    "before the older checkpoint goes": (checkpoint, "_fsync", 7),
    "before a round's metrics are written": (MetricsFile, "append", 5),
}
WITHIN_A_LINE = "within a line of the metrics"


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def die_at(owner, name, call):
    """Makes the process die at that call of the function."""
    function, calls = getattr(owner, name), count(1)

    def counted(*args, **kwargs):
        if next(calls) == call:
            die()
        return function(*args, **kwargs)

    setattr(owner, name, counted)


def die_within_a_line(trainer, _):
    """A callback that makes the process die with half a line of metrics.csv written."""
    if trainer.rounds_done == 5:
        path = trainer.metrics.path
        path.write_bytes(path.read_bytes()[:-25])
        die()


def build(folder):
    spike = Spike(random_policy, 5)
    return make_trainer(folder, rounds=10, replicas=2, capacity=200, spike=spike)


def train(folder, moment=None):
    """Resumes the training, or starts it, and dies at the given moment."""
    trainer = build(folder)
    if moment == WITHIN_A_LINE:
        trainer.callbacks = (die_within_a_line,)
    elif moment is not None:
        die_at(*MOMENTS[moment])
    trainer.train(resume=True)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """An uninterrupted run."""
    trainer = build(tmp_path_factory.mktemp("reference") / "run")
    rows = trainer.train()
    # The comparison means something only if the state that is carried over is a rich one: ragged
    # buffers with protected rows.
    assert len({row["buffer"] for row in rows[-2:]}) == 2
    assert all(trainer.replay.protected)
    return trainer


DAILY = ("while a checkpoint is written", WITHIN_A_LINE)


@pytest.mark.parametrize("moment", nightly([*MOMENTS, WITHIN_A_LINE], DAILY))
def test_a_training_killed_at_the_worst_moment_ends_the_same(tmp_path, reference, moment):
    folder = tmp_path / "run"

    forked.call(lambda: train(folder, moment), cwd=tmp_path, code=-signal.SIGKILL)
    train(folder)

    # what the last checkpoint has is compared with that of the uninterrupted run
    ours = build(folder)
    ours.train(resume=True)
    assert ours.rounds_done == reference.rounds_done == 10
    assert rows(folder / "metrics.csv") == rows(reference.run_folder / "metrics.csv")
    for part in ("learner.loss", "policy", "learner.optimizer", "replay"):
        states = (attrgetter(part)(trainer).state_dict() for trainer in (ours, reference))
        torch.testing.assert_close(*states, rtol=0, atol=0)
    assert not [path for path in (folder / "checkpoint").iterdir() if path.name.startswith(".")]
