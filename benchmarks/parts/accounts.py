"""What a round of training spends its time on."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from bbq_torchrl.trainers import learner
from bbq_torchrl.trainers.learn import LossSums
from benchmarks.parts.timing import Stopwatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from bbq_torchrl.trainers import MetricRow, RoundTrainer


class RoundAccounts:
    """Tells updates, playing and bookkeeping apart while a trainer works.

    Playing is the simulator and the policy. Updates are what is done to a batch (loss, gradient,
    Adam) and the targets that are computed beforehand for many of them. Bookkeeping is the rest:
    storing and checking transitions, shuffling, batching, sums of what the losses report, metrics,
    log files.

    Args:
        trainer: whose work is watched, until :meth:`restore`.
        now: the clock.
    """

    def __init__(self, trainer: RoundTrainer, now: Callable[[], float] = time.perf_counter) -> None:
        self.trainer = trainer
        self._now = now
        self._train_round = trainer.train_round
        self._watch = watch = Stopwatch(now)
        watch.watch(trainer.env, "rollout", "playing")
        watch.watch(learner, "learn_epoch", "epochs")
        watch.watch_iterator(trainer.replay, "epoch", "batches")
        watch.watch(LossSums, "add", "sums")
        watch.watch(trainer.replay, "extend", "storing")
        watch.watch(trainer.learner, "compute_targets", "targets")

    def restore(self) -> None:
        """Lets the trainer work unwatched again."""
        self._watch.restore()

    def train_round(self) -> tuple[list[MetricRow], dict[str, float]]:
        """Trains one round. Returns its rows, and the seconds spent on each kind of work."""
        seconds = self._watch.seconds
        seconds.clear()
        started = self._now()
        rows = self._train_round()
        total = self._now() - started
        updates = seconds["epochs"] - seconds["batches"] - seconds["sums"] + seconds["targets"]
        return rows, {
            "round": total,
            "playing": seconds["playing"],
            "updates": updates,
            "batches": seconds["batches"],
            "storing": seconds["storing"],
            "bookkeeping": total - seconds["playing"] - updates,
        }

    def round(self) -> dict[str, float]:
        """Trains one round. Returns the seconds spent on each kind of work."""
        return self.train_round()[1]
