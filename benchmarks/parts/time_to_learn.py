"""The time until an agent books tickets, in seconds of one core."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from statistics import median_low
from time import process_time
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer
from benchmarks.parts import processes
from benchmarks.parts.learning import AGENTS
from benchmarks.parts.rows import Row

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmarks.parts.sizes import Sizes

LEVEL = 0.6
"""The success rate to reach in an evaluation during training."""

SECONDS = 60
"""The limit of seconds."""


class Learned(NamedTuple):
    """The result of a training.

    Attributes:
        seconds: of processor time until the level was reached, or until training ended.
        is_reached: whether it was.
        rounds: of training until then.
    """

    seconds: float
    is_reached: bool
    rounds: int


def time_to_learn(sizes: Sizes) -> list[Row]:
    """Processor time of ``protocol=quick``, at a constant learning rate, until evaluation success.

    From the start of the process: imports, spiking, rounds, evaluations and checkpoints. Who is not
    there after the protocol's rounds goes on, with all schedules at their end, for up to
    ``sizes.learning_rounds`` rounds in all.
    """
    start = processes.python("-c", "import bbq_torchrl.runs.train").cpu
    rows = []
    for name in ("bbqn-map", "dqn"):
        # At a rate that has fallen, nobody who is late would get there.
        protocol = ("protocol=quick", "protocol.lr_final=1")
        overrides = (*AGENTS[name], *protocol, *sizes.overrides, *sizes.learning_overrides)
        learned = [
            train([*overrides, f"seed={seed}"], sizes.learning_rounds)
            for seed in range(sizes.learning_seeds)
        ]
        rows.append(_row(name, learned, start))
    return rows


def train(overrides: Sequence[str], rounds: int) -> Learned:
    """Trains one replica until it reaches the level, up to a number of rounds."""
    started = process_time()
    with tempfile.TemporaryDirectory() as folder:
        trainer, _ = build_trainer(compose(overrides), Path(folder) / "run")
        trainer.begin()
        done, is_reached = 0, False
        while done < rounds and not is_reached:
            (row,) = trainer.train_round()
            # NaN, in a round without an evaluation, compares as False.
            done, is_reached = done + 1, row["eval_success_rate"] >= LEVEL
        return Learned(process_time() - started, is_reached, done)


def _row(name: str, learned: Sequence[Learned], start: float) -> Row:
    """Returns the median, with lower bounds for seeds that did not reach the level."""
    reached = sum(item.is_reached for item in learned)
    median = median_low(item.seconds if item.is_reached else math.inf for item in learned)
    is_bound = math.isinf(median)
    if is_bound:
        median = median_low(item.seconds for item in learned)
    return Row(
        "time_to_learn",
        f"{name}, protocol=quick: processor time until evaluation success {LEVEL}, median of seeds",
        "s",
        start + median,
        SECONDS,
        is_bound=is_bound,
        remark=f"{reached} of {len(learned)} reached it within {max(i.rounds for i in learned)} "
        "rounds",
    )
