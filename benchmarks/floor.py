"""Writes the least time of an update and of a turn on this machine to results/floor.json.

    OMP_NUM_THREADS=1 python benchmarks/floor.py

The least time is what the steps of ``parts/work.py`` would take at the machine's measured rates,
one after the other: the operations at the rate of a large matrix product, the bytes at that of a
copy within the third-level cache, where the vectors of one network fit, the random numbers and
functions at torch's own. The bare update and the simulator run in the same process.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/floor.py` finds its own packages

import torch  # noqa: E402

from bbq_torchrl.domains import movie_domain  # noqa: E402
from bbq_torchrl.envs import DialogueEnv  # noqa: E402
from bbq_torchrl.trainers import keep_freed_memory  # noqa: E402
from benchmarks.parts.rates import rates  # noqa: E402
from benchmarks.parts.timing import Timer  # noqa: E402
from benchmarks.parts.work import UPDATES, Work, turn, valid_share  # noqa: E402
from benchmarks.parts.yardstick import bare_block  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

FILE = ROOT / "results" / "floor.json"
BARE_BLOCKS, BARE_UPDATES = 15, 100


def least_seconds(work: Work, measured: dict[str, dict[str, float]]) -> float:
    """Returns what a step takes at least, at the measured rates."""
    products, copies, numbers = (measured[kind] for kind in KINDS)
    return (
        work.operations / max(products.values())
        + work.bytes / copies["L3"]
        + work.normals / numbers["normals"]
        + work.uniforms / numbers["uniforms"]
        + work.functions / numbers["exponentials"]
    )


KINDS = ("operations per second", "bytes per second", "numbers per second")


def floor(steps: Iterable[Work], measured: dict[str, dict[str, float]]) -> list[dict[str, Any]]:
    """Returns the steps with their least times."""
    return [{**asdict(step), "least_seconds": least_seconds(step, measured)} for step in steps]


def measure(timer: Timer) -> dict[str, Any]:
    """Measures the machine and counts the work."""
    measured = rates(timer)
    bare = bare_block(timer, BARE_UPDATES)
    env = DialogueEnv(movie_domain(), batch_size=(1_000,), seed=0)
    return {
        "rates": measured,
        "updates": {agent: floor(steps, measured) for agent, steps in UPDATES.items()},
        "turn": floor(turn(env), measured),
        "valid_share": valid_share(env),
        "bare_update_seconds": median(bare() for _ in range(BARE_BLOCKS)),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures and writes the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--file", type=Path, default=FILE, help="default: results/floor.json")
    file = parser.parse_args(arguments).file
    torch.set_num_threads(1)
    keep_freed_memory()
    file.write_text(json.dumps(measure(Timer()), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
