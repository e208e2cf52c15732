"""What things cost, from results/speed.csv, beside the floor; how time and memory grow."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from bbq_torchrl.evaluation.figures import COLORS
from benchmarks.parts.rows import as_table, number, read
from scripts.docs_blocks.common import FIGURES, RESULTS, block, read_csv, table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["draw_growth", "slope"]

UPDATES = {
    "bare dqn": "bare DQN update",
    **{
        agent: f"update of {agent}, replicas=1, buffer of 10,000, sampling included"
        for agent in ("dqn", "bbqn-map", "bbqn-mc")
    },
}
"""Agent -> the row of its measured milliseconds."""
SIZES = {
    "rounds": "rounds",
    "buffer": "transitions in the buffer",
    "replicas": "replicas",
    "dialogues": "dialogues of a round",
    "records": "records, a batch of dialogues",
    "records_build": "records, building",
    "new_values": "records, every tenth a new value",
}
"""What grows -> what its size counts."""


@block("speed")
def _costs() -> str:
    """Returns what is to be reached beside what the last version took."""
    *_, (version, rows) = read(RESULTS / "speed.csv").items()
    return f"{as_table([row for row in rows if row.target is not None])}\n\n(version {version})"


@block("speed.floor")
def _floor() -> str:
    """Returns the least time beside the one measured."""
    *_, rows = read(RESULTS / "speed.csv").values()
    figures = {(row.what, row.unit): row.measured for row in rows}
    pairs = [
        (
            f"update of {agent}",
            1e3 * figures[f"least time of an update of {agent}", "ms"],
            1e3 * figures[what, "ms"],
        )
        for agent, what in UPDATES.items()
    ]
    turns = figures["simulator, 1,000 dialogues in parallel", "turns/s"]
    pairs.append(("turn of a dialogue", figures["least time of a valid turn", "µs"], 1e6 / turns))
    lines = [(what, number(a), number(b), f"{b / a:.2g}") for what, a, b in pairs]
    return table(("what", "least µs", "measured µs", "times the least"), lines, numbers=3)


def slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Returns the exponent b of the fit values = a · sizes^b, by least squares of the logarithms.

    Example:
        >>> round(slope([1, 10, 100], [3.0, 30.0, 300.0]), 3)
        1.0
    """
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def draw_growth() -> Path:
    """Draws time and memory against every size. Returns the file."""
    from matplotlib.figure import Figure

    cells: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    for line in read_csv("growth.csv"):
        what, *cell = line.values()
        cells[what].append(tuple(map(float, cell)))
    figure = Figure(figsize=(2.6 * len(cells), 5.2), layout="constrained")
    axes = figure.subplots(2, len(cells), squeeze=False)
    for column, (what, found) in enumerate(cells.items()):
        sizes, *kinds = zip(*found, strict=True)
        for ax, values, unit, color in zip(
            axes[:, column], kinds, ("seconds", "MB"), COLORS, strict=False
        ):
            ax.loglog(sizes, values, "o-", color=color)
            # from the last point down: what a linear growth would have been
            ax.loglog(sizes, [values[-1] * size / sizes[-1] for size in sizes], ":", color="0.5")
            ax.set_ylim(min(values) / 3, max(values) * 3)
            ax.set_title(f"slope {slope(sizes, values):.2f}", fontsize=9)
            ax.set_xlabel(SIZES[what], fontsize=8)
            ax.set_ylabel(unit if column == 0 else "")
            ax.tick_params(labelsize=7)
            ax.grid(alpha=0.3)
    figure.suptitle("Time and memory by size (dotted: linear)")
    figure.savefig(file := FIGURES / "growth.png", dpi=110)
    return file
