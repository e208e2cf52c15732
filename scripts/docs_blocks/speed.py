"""Tables of costs next to their lower bounds, from results/speed.csv; figure of growth."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from matplotlib.figure import Figure

from bbq_torchrl.utils.reports import COLORS
from benchmarks.parts.rows import as_table, number, read
from scripts.docs_blocks.common import FIGURES, RESULTS, block, read_csv, table

ALONE = "replicas=1, buffer of 10,000, sampling included"
FLOOR = {
    "an update of bare dqn": "bare DQN update",
    **{
        f"an update of {agent}": f"update of {agent}, {ALONE}"
        for agent in ("dqn", "bbqn-map", "bbqn-mc")
    },
    "a valid turn": "simulator, 1,000 dialogues in parallel",
}
"""Lower bound -> the row of the measured time."""

_TO_US = {"ms": lambda value: 1e3 * value, "µs": float, "turns/s": lambda value: 1e6 / value}
"""Unit -> factor to microseconds."""


_SHOWN = {"update", "time_to_learn"}
"""Parts of the comparison with limits on the page, which only counts the met limits of others."""


@block("speed")
def _costs() -> str:
    """Returns the costs of updates and learning in the last version, with their limits."""
    *_, (version, rows) = read(RESULTS / "speed.csv").items()
    limits = [row for row in rows if row.target is not None]
    shown = [row for row in limits if row.part in _SHOWN]
    others = [row for row in limits if row.part not in _SHOWN]
    met = sum(bool(row.reached) for row in others)
    return (
        f"{as_table(shown)}\n\nVersion {version}. Of {len(others)} other limits (simulator, VIME, "
        f"ten heads, memory, the rest of a round) {met} are met."
    )


@block("speed.floor")
def _floor() -> str:
    """Returns lower bounds and measured times."""
    *_, rows = read(RESULTS / "speed.csv").values()
    took = {row.what: _TO_US[row.unit](row.measured) for row in rows if row.unit in _TO_US}
    pairs = [(what, took[f"least time of {what}"], took[row]) for what, row in FLOOR.items()]
    lines = [(what, number(a), number(b), f"{b / a:.2g}") for what, a, b in pairs]
    return table(("what", "least µs", "measured µs", "times the least"), lines, numbers=3)


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
