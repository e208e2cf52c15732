"""What a round of ``agent=bbqn env=full`` on a full buffer spends its time on."""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from bbq_torchrl.trainers import learner
from bbq_torchrl.trainers.learn import LossSums
from benchmarks.parts import processes
from benchmarks.parts.learning import full_trainer
from benchmarks.parts.rows import Row
from benchmarks.parts.timing import Stopwatch

if TYPE_CHECKING:
    from bbq_torchrl.trainers import RoundTrainer
    from benchmarks.parts.sizes import Sizes
    from benchmarks.parts.timing import Timer

PERCENT, ROUNDS = 5, 400
"""Most that may go elsewhere than into simulator and updates; rounds of a whole run."""


def watched_round(trainer: RoundTrainer, timer: Timer) -> dict[str, float]:
    """Trains one round. Returns the seconds spent on each kind of work.

    Playing is the simulator and the policy. Updates are what is done to a batch (loss, gradient,
    Adam) and the targets that are computed beforehand for many of them. Bookkeeping is the rest:
    storing and checking transitions, shuffling, batching, sums of what the losses report, metrics,
    log files.
    """
    watch = Stopwatch(timer.now)
    watch.watch(trainer.env, "rollout", "playing")
    watch.watch(learner, "learn_epoch", "epochs")
    watch.watch_iterator(trainer.replay, "epoch", "batches")
    watch.watch(LossSums, "add", "sums")
    watch.watch(trainer.replay, "extend", "storing")
    watch.watch(trainer.learner, "compute_targets", "targets")
    try:
        total = timer.time(trainer.train_round)
    finally:
        watch.restore()
    spent = watch.seconds
    updates = spent["epochs"] - spent["batches"] - spent["sums"] + spent["targets"]
    return {
        "round": total,
        "playing": spent["playing"],
        "updates": updates,
        "shuffling and batching": spent["batches"],
        "storing": spent["storing"],
        "bookkeeping": total - spent["playing"] - updates,
    }


def rounds(sizes: Sizes, timer: Timer) -> list[Row]:
    """Shares of a round, and what a whole run spends outside of simulator and updates."""
    overrides = ("agent=bbqn", "env=full", *sizes.overrides)
    with tempfile.TemporaryDirectory() as folder:
        started = timer.now()
        run, capacity = Path(folder) / "run", sizes.capacity[1]
        trainer = full_trainer(overrides, run, replicas=1, capacity=capacity)
        trainer.train_round()
        start = timer.now() - started
        found = [watched_round(trainer, timer) for _ in range(sizes.rounds)]
        save = timer.time(lambda: trainer.checkpoints.save(0, {}, name="timed"))
    kinds = {name: median(row[name] for row in found) for name in found[0]}
    kinds["a tenth of a checkpoint"] = save / trainer.settings.checkpoint_every
    whole = kinds.pop("round") + kinds["a tenth of a checkpoint"]
    overhead = kinds.pop("bookkeeping") + kinds["a tenth of a checkpoint"]
    # The start is what a process does before its first round, and the first round's compilation.
    start += processes.python("-c", "import bbq_torchrl.run").wall - whole
    of_run = (start + ROUNDS * overhead) / (start + ROUNDS * whole)
    what, outside = "agent=bbqn env=full, a round with a full buffer", 100 * overhead / whole
    run_what = f"{ROUNDS} such rounds and the start of the process"
    return [
        Row("round", f"{what}: outside simulator and updates", "%", outside, PERCENT),
        Row("round", run_what, "%", 100 * of_run, PERCENT),
        *(
            Row("round", f"{what}: {name}", "% of the round", 100 * seconds / whole)
            for name, seconds in kinds.items()
        ),
        Row("round", what, "s", whole),
    ]
