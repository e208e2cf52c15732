"""Measures each trick of an update alone: the same trainer with and without it, in turn.

    python benchmarks/tricks.py             every trick, some ten minutes
    python benchmarks/tricks.py --tiny      in seconds; checks that the benchmark works

Writes ``results/tricks.csv``: the time of an update and what it takes longer without the trick, in
percent, the median over the blocks with the quarter of them below and above. One thread.
"""

from __future__ import annotations

import argparse
import csv
import logging
import statistics
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/tricks.py` finds its own packages

import torch  # noqa: E402

from bbq_torchrl.bayes import collect_kl, held_std, noise_pool  # noqa: E402
from bbq_torchrl.bayes.posterior import GaussianPosterior  # noqa: E402
from bbq_torchrl.objectives import OneStepQLoss  # noqa: E402
from bbq_torchrl.trainers import keep_freed_memory, learn  # noqa: E402
from benchmarks.parts.learning import AGENTS, TINY_CAPACITY, TINY_OVERRIDES, Learner  # noqa: E402
from benchmarks.parts.timing import Timer  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Sequence

RESULT = ROOT / "results" / "tricks.csv"
COLUMNS = ("trick", "agent", "replicas", "with_ms", "without_percent", "low", "high")


def _two_passes(posterior: GaussianPosterior, kind: str, known_kl: object = None) -> tuple:
    return posterior.sample(), posterior.kl()


_collect_kl = collect_kl.__init__

NO_POOL = patch.object(noise_pool, "window", lambda *_: None)

# trick -> the agents it is for, what is so in both cases, and what takes it away
TRICKS: dict[str, tuple[tuple[str, ...], list, list]] = {
    "dropout from a pool": (
        ("dqn",),
        [],
        [patch.object(noise_pool, "kept_units", lambda *_: None)],
    ),
    "sigma of the frozen posterior held": (
        ("bbqn-mc",),
        [],
        [patch.object(held_std, "active", classmethod(lambda cls: None))],
    ),
    "value of the KL held": (
        ("bbqn-map", "bbqn-mc"),
        [],
        [
            patch.object(
                collect_kl, "__init__", lambda self, kind, held=None: _collect_kl(self, kind)
            )
        ],
    ),
    "losses added up by 64": (("dqn", "bbqn-map"), [], [patch.object(learn, "_AT_ONCE", 1)]),
    "noise from a pool": (("bbqn-map", "bbqn-mc"), [], [NO_POOL]),
    "fast normal numbers, without a pool": (
        ("bbqn-map",),
        [NO_POOL],
        [patch.object(GaussianPosterior, "fill_noise_", lambda self, noise: noise.normal_())],
    ),
    "draw and KL in one pass": (
        ("bbqn-map",),
        [],
        [patch.object(GaussianPosterior, "sample_with_kl", _two_passes)],
    ),
    "targets once a freeze": (
        ("dqn", "bbqn-map"),
        [],
        [
            patch.object(cls, "has_fixed_targets", False)
            for cls in (OneStepQLoss, *OneStepQLoss.__subclasses__())
            if "has_fixed_targets" in vars(cls)
        ],
    ),
}


def measure(learner: Learner, common: list, taken_away: list, repeats: int) -> tuple[float, list]:
    """Returns the median seconds of an update, and the ratios without to with, sorted."""

    def block(patches: list) -> float:
        with ExitStack() as stack:
            for one in (*common, *patches):
                stack.enter_context(one)
            return learner.learn()

    block([]), block(taken_away)  # first calls
    seconds, ratios = [block([])], []
    for _ in range(repeats):
        without = block(taken_away)
        seconds.append(block([]))
        ratios.append(2 * without / (seconds[-1] + seconds[-2]))
    return statistics.median(seconds), sorted(ratios)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures the tricks and writes the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tiny", action="store_true", help="sizes that only test the benchmark")
    parser.add_argument("--repeats", type=int, default=12)
    parser.add_argument("--out", type=Path, default=RESULT)
    chosen = parser.parse_args(arguments)
    torch.set_num_threads(1)
    keep_freed_memory()
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage
    capacity, more = (
        (TINY_CAPACITY, (*TINY_OVERRIDES, "protocol.eval_every=0"))
        if chosen.tiny
        else (3_200, ("protocol.eval_every=0",))
    )
    rows = []
    for replicas in (1, 10):
        for trick, (agents, common, taken_away) in TRICKS.items():
            for agent in agents:
                with tempfile.TemporaryDirectory() as folder:
                    learner = Learner(
                        (*AGENTS[agent], *more),
                        Path(folder) / "run",
                        Timer("cpu"),
                        replicas=replicas,
                        capacity=capacity,
                    )
                    seconds, ratios = measure(learner, common, taken_away, chosen.repeats)
                low, middle, high = (100 * (r - 1) for r in statistics.quantiles(ratios, n=4))
                numbers = (f"{1e3 * seconds:.3f}", f"{middle:.1f}", f"{low:.1f}", f"{high:.1f}")
                rows.append((trick, agent, replicas, *numbers))
                sys.stderr.write(f"{rows[-1]}\n")
    with chosen.out.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


if __name__ == "__main__":
    main()
