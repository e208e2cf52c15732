"""Time and memory against rounds, buffer, replicas, dialogues of a round and records.

    OMP_NUM_THREADS=1 python benchmarks/growth.py            what results/growth.csv lacks
    OMP_NUM_THREADS=1 python benchmarks/growth.py --fresh    everything, under ten minutes
    python benchmarks/growth.py --tiny                       seconds; tests the script itself

Each cell runs in a process of its own, whose peak of memory is what it adds to the imported
packages. A cell is written to results/growth.csv as soon as it is measured, so that a run that was
stopped goes on. ``scripts/write_docs.py`` makes figure and table.
"""

from __future__ import annotations

import argparse
import csv
import logging
import multiprocessing
import resource
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # so that `python benchmarks/growth.py` finds its own packages

import torch  # noqa: E402

from bbq_torchrl.trainers import keep_freed_memory  # noqa: E402
from benchmarks.parts.cells import GROWTH, TINY_SIZES  # noqa: E402
from benchmarks.parts.timing import CLOCKS, Timer  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Sequence
    from multiprocessing.connection import Connection

FILE = ROOT / "results" / "growth.csv"
COLUMNS = ("what", "size", "seconds", "megabytes")

Line = dict[str, Any]


def read(file: Path) -> list[Line]:
    """Returns the cells measured so far."""
    if not file.is_file():
        return []
    with file.open(newline="", encoding="utf-8") as opened:
        return [
            {
                "what": line["what"],
                "size": int(line["size"]),
                "seconds": float(line["seconds"]),
                "megabytes": float(line["megabytes"]),
            }
            for line in csv.DictReader(opened)
        ]


def write(file: Path, lines: list[Line]) -> None:
    """Writes the cells in the order of the table."""
    order = list(GROWTH)
    lines = sorted(lines, key=lambda line: (order.index(line["what"]), line["size"]))
    with file.open("w", newline="", encoding="utf-8") as opened:
        writer = csv.DictWriter(opened, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def measure(what: str, size: int, clock: str) -> Line:
    """Measures one cell in a child process.

    Raises:
        RuntimeError: if the child fails.
    """
    # A fork has everything imported already: only what the cell itself needs is counted.
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_cell, args=(what, size, clock, sender))
    child.start()
    sender.close()
    try:
        seconds, peak = receiver.recv()
    except EOFError as error:
        child.join()
        raise RuntimeError(f"{what} at {size} failed with exit code {child.exitcode}") from error
    child.join()
    return {
        "what": what,
        "size": size,
        "seconds": round(seconds, 6),
        "megabytes": round(peak / 1e6, 3),
    }


def _cell(what: str, size: int, clock: str, sender: Connection) -> None:
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage
    torch.set_num_threads(1)
    keep_freed_memory()
    before = _peak()
    seconds = GROWTH[what][0](size, Timer(clock))
    sender.send((seconds, max(_peak() - before, 1)))


def _peak() -> int:
    """Returns the most bytes that this process has had in memory at a time."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures the cells that are missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="*", choices=[*GROWTH, []], help="default: all")
    parser.add_argument("--fresh", action="store_true", help="measure again what is there")
    parser.add_argument("--tiny", action="store_true", help="sizes that only test the script")
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="default: wall")
    parser.add_argument("--file", type=Path, default=FILE, help="default: results/growth.csv")
    chosen = parser.parse_args(arguments)
    if chosen.tiny:
        with tempfile.TemporaryDirectory() as folder:
            chosen.file = Path(folder) / "growth.csv"
            _measure_all(chosen, dict(TINY_SIZES))
    else:
        _measure_all(chosen, {what: sizes for what, (_, sizes, _) in GROWTH.items()})


def _measure_all(chosen: argparse.Namespace, sizes: dict[str, tuple[int, ...]]) -> None:
    wanted = [(what, size) for what in chosen.what or sizes for size in sizes[what]]
    lines = read(chosen.file)
    if chosen.fresh:
        lines = [line for line in lines if (line["what"], line["size"]) not in wanted]
    done = {(line["what"], line["size"]) for line in lines}
    for what, size in wanted:
        if (what, size) not in done:
            lines.append(measure(what, size, chosen.clock))
            write(chosen.file, lines)
            print(*(f"{name} {lines[-1][name]}" for name in COLUMNS), sep=", ", flush=True)


if __name__ == "__main__":
    main()
