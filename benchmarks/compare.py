"""Measures the project's speed in one run, and prints it next to the targets.

    python benchmarks/compare.py                    everything: a quarter of an hour
    python benchmarks/compare.py simulator update   these parts
    python benchmarks/compare.py --save 0.2.0       keeps the figures in results/speed.csv
    python benchmarks/compare.py --tiny             in seconds; checks that the benchmark works

Updates are counted as users run them: the learning of a trainer on a full replay buffer, with
freezing, targets, shuffling and batching, divided by its updates and replicas. They are compared
with the hand-written update of ``parts/yardstick.py``, which runs in turn with them, block by
block, in processor time of one thread. The table says which torch a row was measured with.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/compare.py` finds its own packages

from benchmarks.parts.floor import floor  # noqa: E402
from benchmarks.parts.processes import process  # noqa: E402
from benchmarks.parts.rounds import rounds  # noqa: E402
from benchmarks.parts.rows import as_table, keep  # noqa: E402
from benchmarks.parts.simulator import simulator  # noqa: E402
from benchmarks.parts.sizes import FULL, TINY  # noqa: E402
from benchmarks.parts.time_to_learn import time_to_learn  # noqa: E402
from benchmarks.parts.timing import one_thread  # noqa: E402
from benchmarks.parts.updates import agents, update  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Sequence

FILE = ROOT / "results" / "speed.csv"
PARTS = {
    "simulator": simulator,
    "update": update,
    "agents": agents,
    "round": rounds,
    "process": process,
    "time_to_learn": time_to_learn,
    "floor": floor,
}
"""Name -> the function that measures it, in the order of the table."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures the given parts, by default all, and prints them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="default: all")
    parser.add_argument("--save", metavar="VERSION", help="keep the figures as a version's")
    parser.add_argument("--tiny", action="store_true", help="sizes that only test the benchmark")
    parser.add_argument("--file", type=Path, default=FILE, help="default: results/speed.csv")
    chosen = parser.parse_args(arguments)
    sizes, rows = TINY if chosen.tiny else FULL, []
    one_thread()
    for part in chosen.parts or PARTS:
        sys.stderr.write(f"measuring: {part}\n")
        measured = PARTS[part](sizes)
        rows += measured
        if chosen.save:
            keep(chosen.file, chosen.save, measured)
    print(as_table(rows))


if __name__ == "__main__":
    main()
