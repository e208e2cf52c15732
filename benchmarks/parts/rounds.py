"""The share of a round of ``agent=bbqn env=full`` outside simulator and updates."""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import TYPE_CHECKING

from bbq_torchrl.trainers.learn import LossSums
from benchmarks.parts import processes
from benchmarks.parts.learning import full_trainer
from benchmarks.parts.rows import Row
from benchmarks.parts.timing import seconds, stopwatch

if TYPE_CHECKING:
    from bbq_torchrl.trainers import RoundTrainer
    from benchmarks.parts.sizes import Sizes

PERCENT, ROUNDS = 5, 400
"""The largest share outside simulator and updates; rounds of a whole run."""


def watched_round(trainer: RoundTrainer) -> tuple[float, float]:
    """Trains one round. Returns its seconds, and those outside simulator and updates.

    The simulator's are those of playing, with the policy's. Updates are what is done to a batch
    (loss, gradient, Adam) and the targets that are computed beforehand for many of them. The rest
    is storing and checking transitions, shuffling, batching, sums of what the losses report,
    metrics, log files.
    """
    with (
        stopwatch(trainer.env, "rollout") as played,
        stopwatch(trainer.learner, "compute_targets") as computed,
        stopwatch(trainer.learner, "update") as updated,
        stopwatch(LossSums, "add") as sums,
    ):
        total = seconds(trainer.train_round)
    return total, total - sum([*played, *computed, *updated]) + sum(sums)


def rounds(sizes: Sizes) -> list[Row]:
    """Shares of a round, and of a whole run, outside simulator and updates."""
    overrides = ("agent=bbqn", "env=full", *sizes.overrides)
    with tempfile.TemporaryDirectory() as folder:
        started = perf_counter()
        run, capacity = Path(folder) / "run", sizes.capacity
        trainer = full_trainer(overrides, run, replicas=1, capacity=capacity)
        trainer.train_round()
        start = perf_counter() - started
        found = [watched_round(trainer) for _ in range(sizes.rounds)]
        save = seconds(lambda: trainer.checkpoints.save(0, {}, name="timed"))
    share = save / trainer.checkpoint_every
    whole, outside = (median(took) + share for took in zip(*found, strict=True))
    # The start is everything before the first round, and the compilation in it.
    start += processes.python("-c", "import bbq_torchrl.runs.train").wall - whole
    of_run = (start + ROUNDS * outside) / (start + ROUNDS * whole)
    what = "agent=bbqn env=full, a round with a full buffer"
    run_what = f"{ROUNDS} such rounds and the start of the process"
    percent = 100 * outside / whole
    return [
        Row("round", f"{what}: outside simulator and updates", "%", percent, PERCENT),
        Row("round", run_what, "%", 100 * of_run, PERCENT),
        Row("round", what, "s", whole),
    ]
