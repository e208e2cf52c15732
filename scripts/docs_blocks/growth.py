"""Table and figure of growth, from results/growth.csv."""

from __future__ import annotations

import csv
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bbq_torchrl.evaluation.figures import COLORS
from benchmarks.parts.cells import GROWTH
from scripts.docs_blocks.markdown import table
from scripts.docs_blocks.speed import number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["draw_growth", "growth_blocks", "slope"]

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "results" / "growth.csv"
FIGURE = ROOT / "docs" / "figures" / "growth.png"


class Series(NamedTuple):
    """What was measured against one size."""

    sizes: list[int]
    seconds: list[float]
    megabytes: list[float]


def growth_blocks() -> dict[str, Callable[[], str]]:
    """Returns the block of growth."""
    return {"growth": _growth}


def slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Returns the exponent b of the fit values = a · sizes^b, by least squares of the logarithms.

    Example:
        >>> round(slope([1, 10, 100], [3.0, 30.0, 300.0]), 3)
        1.0
    """
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def _read() -> dict[str, Series]:
    found: dict[str, Series] = defaultdict(lambda: Series([], [], []))
    if FILE.is_file():
        with FILE.open(newline="", encoding="utf-8") as file:
            for line in csv.DictReader(file):
                series = found[line["what"]]
                series.sizes.append(int(line["size"]))
                series.seconds.append(float(line["seconds"]))
                series.megabytes.append(float(line["megabytes"]))
    return {what: found[what] for what in GROWTH if len(found[what].sizes) > 1}


def _growth() -> str:
    """Returns the figure, and a row for each size that grows."""
    measured = _read()
    if not measured:
        return "Not measured yet; `python benchmarks/growth.py` does."
    rows = []
    for what, (sizes, seconds, megabytes) in measured.items():
        title = GROWTH[what][2]
        rows.append(
            (
                title,
                f"{sizes[0]:,} to {sizes[-1]:,}",
                *_columns(sizes, seconds, "s"),
                *_columns(sizes, megabytes, "MB"),
            )
        )
    head = (
        "what grows",
        "from, to",
        "time",
        "slope",
        "last slope",
        "memory",
        "slope",
        "last slope",
    )
    meanings = "\n".join(f"- {GROWTH[what][2]}: {_meaning(GROWTH[what][0])}" for what in measured)
    return (
        f"![Time and memory by size](figures/{FIGURE.name})\n\n{table(head, rows, numbers=6)}\n\n"
        "(Slopes of the logarithms: 1 is linear. *Slope* is that of the fit through all sizes, "
        "*last slope* that of the last step. Memory is the peak, less the imported packages.)\n\n"
        f"{meanings}\n\n```bash\nOMP_NUM_THREADS=1 python benchmarks/growth.py --fresh\n```"
    )


def _columns(sizes: list[int], values: list[float], unit: str) -> tuple[str, str, str]:
    return (
        f"{number(values[0])} to {number(values[-1])} {unit}",
        f"{slope(sizes, values):.2f}",
        f"{slope(sizes[-2:], values[-2:]):.2f}",
    )


def _meaning(cell: Callable[..., float]) -> str:
    text = (cell.__doc__ or "").splitlines()[0]
    return text[0].lower() + text[1:]


def draw_growth() -> list[Path]:
    """Draws time and memory against every size; returns the file, if there is anything to draw."""
    measured = _read()
    if not measured:
        return []
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.6 * len(measured), 5.2), layout="constrained")
    axes = figure.subplots(2, len(measured), squeeze=False)
    for column, (what, (sizes, *kinds)) in enumerate(measured.items()):
        for row, (values, unit, color) in enumerate(
            zip(kinds, ("seconds", "MB"), COLORS, strict=False)
        ):
            ax = axes[row, column]
            ax.loglog(sizes, values, "o-", color=color)
            # from the last point down: what a linear growth would have been
            ax.loglog(sizes, [values[-1] * size / sizes[-1] for size in sizes], ":", color="0.5")
            ax.set_ylim(min(values) / 3, max(values) * 3)
            ax.set_title(f"slope {slope(sizes, values):.2f}", fontsize=9)
            ax.set_xlabel(GROWTH[what][2], fontsize=8)
            ax.tick_params(labelsize=7)
            ax.grid(alpha=0.3)
            if column == 0:
                ax.set_ylabel(unit)
    figure.suptitle("Time and memory by size (dotted: linear)")
    figure.savefig(FIGURE, dpi=110)
    return [FIGURE]
