"""Draws docs/figures/gp_cost.png, the cost of a round's learning, from results/growth.csv.

OMP_NUM_THREADS=1 python benchmarks/growth.py buffer gp exact_gp
python benchmarks/gp_figure.py
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parent.parent
KINDS = {
    "buffer": ("BBQN, a freeze and an epoch", "#0072B2", "o"),
    "gp": ("sparse GP, 512 inducing states", "#009E73", "^"),
    "exact_gp": ("exact GP, one Cholesky", "#D55E00", "s"),
}
"""Measurement of benchmarks/growth.py -> label, color, marker."""


def draw(table: Path, file: Path) -> None:
    """Draws seconds and megabytes against the transitions in the buffer.

    Args:
        table: results/growth.csv.
        file: a PNG or SVG file.
    """
    with table.open(newline="", encoding="utf-8") as opened:
        rows = list(csv.DictReader(opened))
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, column in zip(figure.subplots(1, 2), ("seconds", "megabytes"), strict=True):
        for kind, (label, color, marker) in KINDS.items():
            points = [(int(row["size"]), float(row[column])) for row in rows if row["what"] == kind]
            axes.loglog(*zip(*points, strict=True), color=color, marker=marker, label=label)
        axes.set_xlabel("transitions in the buffer (1,000 are about a round)")
        axes.set_ylabel(column)
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    draw(ROOT / "results" / "growth.csv", ROOT / "docs" / "figures" / "gp_cost.png")
    sys.stdout.write("docs/figures/gp_cost.png\n")
