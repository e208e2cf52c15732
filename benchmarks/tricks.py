"""What an update takes longer without a trick: the same trainer with and without it, in turn.

    OMP_NUM_THREADS=1 python benchmarks/tricks.py    # adds to results/tricks.csv

``adam`` is :class:`ReplicaAdam`'s step beside ``torch.optim.Adam.step`` on the same parameters,
``epochs`` the memory that epochs are gathered into, kept or allocated anew for each.
"""

from __future__ import annotations

import csv
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from bbq_torchrl.data.rows import EpochMemory
from bbq_torchrl.trainers import ReplicaAdam, keep_freed_memory
from benchmarks.parts.learning import AGENTS, full_trainer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bbq_torchrl.trainers import RoundTrainer

FILE = Path(__file__).resolve().parent.parent / "results" / "tricks.csv"
OWN_STEP = ReplicaAdam.step


@torch.no_grad()
def step_with_hooks(self: ReplicaAdam, active: Sequence[bool] | None = None) -> None:
    """Moves the replicas by Adam's own step, with its hooks and checks."""
    flags = (True,) * self.replicas if active is None else active
    for number, parameter in enumerate(self.parameters):
        for views, gradient, is_active in zip(self._views, parameter.grad, flags, strict=True):
            views[number].grad = gradient if is_active else None
    self._adam.step()


def adam(trainer: RoundTrainer, is_on: bool) -> None:
    """Takes the functional step, or Adam's own."""
    ReplicaAdam.step = OWN_STEP if is_on else step_with_hooks  # type: ignore[method-assign]


class Fresh(EpochMemory):
    """Keeps nothing from one epoch to the next."""

    def gather(self, *args):  # type: ignore[no-untyped-def]
        """Returns an epoch in new memory."""
        self._memory.clear()
        return super().gather(*args)


def epochs(trainer: RoundTrainer, is_on: bool) -> None:
    """Keeps the memory of epochs, or does not."""
    trainer.replay._memory.__class__ = EpochMemory if is_on else Fresh


def measure(
    trick: Callable[[RoundTrainer, bool], None], agent: str, replicas: int, capacity: int, n: int
) -> tuple[float, ...]:
    """Returns the time with the trick (ms), and the percent more without: median, quartiles."""
    with tempfile.TemporaryDirectory() as folder:
        overrides = [*AGENTS[agent], "protocol.freezes=1"]
        trainer = full_trainer(overrides, Path(folder) / "r", replicas=replicas, capacity=capacity)

        def block(is_on: bool, number: int) -> float:
            trick(trainer, is_on)
            started = time.process_time()
            trainer.learner.learn(number)
            return (time.process_time() - started) / sum(trainer.learner.updates)

        block(True, 0)
        pairs = []
        for number in range(1, n + 1):
            both = [block(bool(number % 2), number), block(not number % 2, number)]
            pairs.append(both if number % 2 else both[::-1])
    on, off = np.array(pairs).T
    return (1e3 * np.median(on), *(100 * (np.quantile(off / on, [0.5, 0.25, 0.75]) - 1)))


def main() -> None:
    """Measures and adds the rows."""
    torch.set_num_threads(1)
    keep_freed_memory()
    adams, epoch = "Adam's step without hooks", "memory of epochs kept"
    rows = [
        (adams, "dqn", 1, adam, 600, 40),
        (epoch, "dqn", 1, epochs, 10_000, 13),
        (adams, "dqn", 10, adam, 600, 12),
        (epoch, "dqn", 10, epochs, 10_000, 4),
        (adams, "bbqn-map", 1, adam, 600, 40),
    ]
    with FILE.open("a", newline="", encoding="utf-8") as opened:
        writer = csv.writer(opened, lineterminator="\n")
        for name, agent, replicas, trick, capacity, n in rows:
            ms, *percent = measure(trick, agent, replicas, capacity, n)
            writer.writerow((name, agent, replicas, f"{ms:.3f}", *(f"{p:.1f}" for p in percent)))
            opened.flush()


if __name__ == "__main__":
    main()
