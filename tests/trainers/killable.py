"""Trainings in processes of their own that kill themselves (SIGKILL) at a chosen moment.

Run as a program, this is a server: it imports everything once and forks a process for every line
of JSON on its standard input, ``{"folder": ..., "moment": ...}``; when the process is over it
answers ``exit <code>``. Importing torch and torchrl anew for every kill takes seconds.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import traceback
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torchrl.checkpoint import StateDictCheckpointAdapter
from trainer_parts import make_trainer

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.trainers import (
    MetricsFile,
    ReplicaAdam,
    RoundTrainer,
    SpikeSettings,
    checkpoint,
)

if TYPE_CHECKING:
    from collections.abc import Callable

ROUNDS = 10

# Where a process dies: the function, and which of its calls. Rounds 2, 4, ... save a checkpoint of
# five parts, the first one is saved right after the spike (one call of extend).
MOMENTS: dict[str, tuple[object, str, int]] = {
    "while the buffer is spiked": (ReplicaReplay, "extend", 1),
    "while the first checkpoint is staged": (StateDictCheckpointAdapter, "save", 3),
    "before the first checkpoint is published": (os, "replace", 1),
    "in the first round": (ReplicaReplay, "extend", 2),
    "in the middle of an epoch": (ReplicaAdam, "step", 70),
    "while a checkpoint is staged": (StateDictCheckpointAdapter, "save", 12),
    "while a checkpoint is written": (zipfile.ZipFile, "write", 130),
    "before a checkpoint is published": (os, "replace", 3),
    "before the older checkpoint goes": (checkpoint, "_force_to_disk", 7),
    "while the last checkpoint is published": (os, "replace", 6),
    "before a round's metrics are written": (MetricsFile, "append", 5),
}


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def die_at(owner: object, name: str, call: int) -> None:
    """Makes the process die when the function is called for that time."""
    function: Callable = getattr(owner, name)
    calls = 0

    def counted(*args: object, **kwargs: object) -> object:
        nonlocal calls
        calls += 1
        if calls == call:
            die()
        return function(*args, **kwargs)

    setattr(owner, name, counted)


def die_within_a_line(row_block: int) -> None:
    """Makes the process die with half a line of metrics.csv written."""
    append = MetricsFile.append
    calls = 0

    def torn(self: MetricsFile, *round_and_columns: object) -> list:
        nonlocal calls
        calls += 1
        rows = append(self, *round_and_columns)
        if calls == row_block:
            text = self.path.read_bytes()
            self.path.write_bytes(text[:-25])
            die()
        return rows

    MetricsFile.append = torn


def build(folder: Path) -> RoundTrainer:
    torch.set_num_threads(1)
    return make_trainer(
        folder,
        rounds=ROUNDS,
        replicas=2,
        spike=SpikeSettings(dialogues=5, drop_above=0.7, drop_window=2),
    )


def train(folder: str, moment: str | None) -> None:
    """Goes on with the training, or begins it, and dies at the moment."""
    logging.getLogger("torchrl").setLevel(logging.ERROR)
    trainer = build(Path(folder))
    if moment == "within a line of the metrics":
        die_within_a_line(5)
    elif moment is not None:
        die_at(*MOMENTS[moment])
    trainer.train(resume=True)


def serve() -> None:
    torch.set_num_threads(1)
    for line in sys.stdin:
        request = json.loads(line)
        child = os.fork()
        if child == 0:
            try:
                train(**request)
            except BaseException:
                traceback.print_exc()
                os._exit(1)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        print("exit", os.waitstatus_to_exitcode(status), flush=True)


if __name__ == "__main__":
    serve()
