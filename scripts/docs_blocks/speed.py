"""Tables of costs next to their lower bounds, from results/speed.csv; figure of growth."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from matplotlib.figure import Figure

from bbq_torchrl.utils.reports import COLORS
from benchmarks.parts.rows import as_table, read
from scripts.docs_blocks.common import FIGURES, RESULTS, block, read_csv

_SHOWN = {"update", "time_to_learn"}
"""Parts of the comparison with limits on the page, which only counts the met limits of others."""


@block("speed")
def _costs() -> str:
    """Returns the costs of updates and learning as last measured, with their limits."""
    versions = read(RESULTS / "speed.csv")
    del versions["start"]  # before the limits
    last = {(row.part, row.what, row.unit): row for rows in versions.values() for row in rows}
    limits = [row for row in last.values() if row.target is not None]
    shown = [row for row in limits if row.part in _SHOWN]
    others = [row for row in limits if row.part not in _SHOWN]
    met = sum(bool(row.reached) for row in others)
    return (
        f"{as_table(shown)}\n\nRows without a torch are of 2.13.0 and an earlier version. Of "
        f"{len(others)} other limits (simulator, VIME, ten heads, memory, the rest of a round) "
        f"{met} are met."
    )


def draw_growth() -> None:
    """Draws time and memory against every size, each as a multiple of its first figure."""
    cells = defaultdict(list)
    for what, *cell in (line.values() for line in read_csv("growth.csv")):
        if not what.endswith("gp"):  # benchmarks/gp_figure.py draws these
            cells[what].append([float(value) for value in cell])
    figure = Figure(figsize=(9, 4), layout="constrained")
    for ax, column, title in zip(figure.subplots(1, 2), (1, 2), ("time", "memory"), strict=True):
        for (what, lines), color in zip(cells.items(), COLORS, strict=True):
            sizes, values = (
                [line[place] / lines[0][place] for line in lines] for place in (0, column)
            )
            slope, _ = np.polyfit(np.log(sizes), np.log(values), 1)
            label = f"{what}: slope {slope:.2f}"
            ax.loglog(sizes, values, "o-", color=color, markersize=4, label=label)
        ax.loglog([1, 1000], [1, 1000], ":", color="0.5", label="linear")
        ax.set(title=title, xlabel="size, times the least", ylabel=f"{title}, times the first")
        ax.grid(alpha=0.3)
        ax.legend(fontsize=7)
    figure.savefig(FIGURES / "growth.png", dpi=110)
