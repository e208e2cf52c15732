"""Measures each trick of an update alone: the same trainer with and without it, in turn.

    python benchmarks/tricks.py             every trick, some ten minutes
    python benchmarks/tricks.py --tiny      in seconds; checks that the benchmark works
    python benchmarks/tricks.py --tricks "noise from a pool" --replicas 1

Writes ``results/tricks.csv``: the time of an update and what it takes longer without the trick, in
percent, the median over the blocks with the quarter of them below and above. Lines of tricks that
are not measured stay, also of those that went. One thread, processor time.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/tricks.py` finds its own packages

from bbq_torchrl.bayes import GaussianPosterior, KLSum  # noqa: E402
from bbq_torchrl.bayes.noise_sources import NoisePool  # noqa: E402
from bbq_torchrl.data import ReplicaReplay  # noqa: E402
from bbq_torchrl.objectives import OneStepQLoss  # noqa: E402
from bbq_torchrl.trainers import learn  # noqa: E402
from benchmarks.parts.learning import AGENTS, TINY_CAPACITY, TINY_OVERRIDES, Learner  # noqa: E402
from benchmarks.parts.rows import merge  # noqa: E402
from benchmarks.parts.timing import Comparison, Timer, interleaved, one_thread  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase
    from torch import Size, Tensor

RESULT = ROOT / "results" / "tricks.csv"
COLUMNS = ("trick", "agent", "replicas", "with_ms", "without_percent", "low", "high")


def _two_passes(posterior: GaussianPosterior, kind: str, known_kl: object = None) -> tuple:
    return posterior.sample(), posterior.kl()


def _target_each_batch(loss: OneStepQLoss, following: TensorDictBase, *parameters: list) -> Tensor:
    key = loss.tensor_keys.next_state_value
    return _td_target(loss, following.exclude(key), *parameters)


def _kl_each_batch(kl: KLSum, kind: str, known: object = None) -> None:
    _kl_sum(kl, kind)


def _sigma_each_draw(posterior: GaussianPosterior, held: object) -> Tensor:
    return posterior.sigma


def _noise_each_draw(pool: NoisePool, posterior: GaussianPosterior, shape: Size) -> Tensor:
    return posterior.new_noise(shape)


_td_target, _kl_sum = OneStepQLoss._td_target, KLSum.__init__
NO_POOL = patch.object(NoisePool, "normal", _noise_each_draw)
TORCHS_NORMALS = patch.object(GaussianPosterior, "fill_noise_", lambda _, noise: noise.normal_())
NEW_SIGMA = patch.object(GaussianPosterior, "_sigma_held", _sigma_each_draw)
NEW_KL = patch.object(KLSum, "__init__", _kl_each_batch)
TWO_PASSES = patch.object(GaussianPosterior, "sample_with_kl", _two_passes)
ADDED_UP_AT_ONCE = patch.object(learn, "_AT_ONCE", 1)
NEW_TARGET = patch.object(OneStepQLoss, "_td_target", _target_each_batch)
NOTHING_COMPUTED = patch.object(ReplicaReplay, "compute", lambda *_: None)

# trick -> the agents it is for, what is so in both cases, and what takes it away
TRICKS: dict[str, tuple[tuple[str, ...], list, list]] = {
    "sigma of the frozen posterior held": (("bbqn-mc",), [], [NEW_SIGMA]),
    "value of the KL held": (("bbqn-map", "bbqn-mc"), [], [NEW_KL]),
    "losses added up by 64": (("dqn", "bbqn-map"), [], [ADDED_UP_AT_ONCE]),
    "noise from a pool": (("bbqn-map", "bbqn-mc"), [], [NO_POOL]),
    "fast normal numbers, without a pool": (("bbqn-map",), [NO_POOL], [TORCHS_NORMALS]),
    "draw and KL in one pass": (("bbqn-map",), [], [TWO_PASSES]),
    "targets once a freeze": (("dqn", "bbqn-map"), [], [NEW_TARGET, NOTHING_COMPUTED]),
}


def measure(learner: Learner, common: list, taken_away: list, repeats: int) -> Comparison:
    """Compares updates without the trick with those that have it."""

    def block(patches: list) -> float:
        with ExitStack() as stack:
            for one in (*common, *patches):
                stack.enter_context(one)
            return learner.learn()

    block([]), block(taken_away)  # first calls
    return interleaved(lambda: block([]), lambda: block(taken_away), repeats)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures the tricks and writes the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tiny", action="store_true", help="sizes that only test the benchmark")
    parser.add_argument("--repeats", type=int, default=8)
    parser.add_argument("--tricks", nargs="*", choices=TRICKS, default=list(TRICKS))
    parser.add_argument("--replicas", nargs="*", type=int, default=[1, 10])
    parser.add_argument("--out", type=Path, default=RESULT)
    chosen = parser.parse_args(arguments)
    capacity, more = 3_200, ("protocol.eval_every=0",)
    if chosen.tiny:
        capacity, more = TINY_CAPACITY, (*TINY_OVERRIDES, *more)
    for replicas, trick in product(chosen.replicas, chosen.tricks):
        agents, common, taken_away = TRICKS[trick]
        for agent in agents:
            with one_thread(), tempfile.TemporaryDirectory() as folder:
                learner = Learner(
                    (*AGENTS[agent], *more),
                    Path(folder) / "run",
                    Timer("cpu"),
                    replicas=replicas,
                    capacity=capacity,
                )
                found = measure(learner, common, taken_away, chosen.repeats)
            low, middle, high = (100 * (r - 1) for r in statistics.quantiles(found.ratios, n=4))
            figures = (f"{x:.1f}" for x in (middle, low, high))
            line = (trick, agent, replicas, f"{1e3 * found.base:.3f}", *figures)
            merge(chosen.out, COLUMNS, 3, [line])
            sys.stderr.write(f"{line}\n")


if __name__ == "__main__":
    main()
