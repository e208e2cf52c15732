"""Reports: text, figures, and tables as Markdown and CSV."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

from bbq_torchrl.utils.files import csv_text, write_bytes, write_text
from bbq_torchrl.utils.text import EMPTY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from bbq_torchrl.utils.statistics import Estimate


@dataclass(frozen=True)
class Table:
    """A table of a report.

    Attributes:
        name: the name of its CSV file.
        rows: column -> cell; a missing cell is shown as a dash. A column such as
            ``reward: the paper's`` is headed by the part after the colon. A cell with a method
            ``csv_columns()``, suffix -> number, is written to CSV as several columns.
        words: the number of leading columns that are text.
    """

    name: str
    rows: Sequence[Mapping[str, object]]
    words: int = 1

    def __str__(self) -> str:
        """Returns the table as Markdown; empty without rows."""
        if not self.rows:
            return ""
        names = dict.fromkeys(name for row in self.rows for name in row)
        cells = [[_shown(row.get(name, EMPTY)) for name in names] for row in self.rows]
        head = [name.rpartition(": ")[2] for name in names]
        return table(head, cells, numbers=len(head) - self.words)

    def write(self, folder: Path) -> None:
        """Writes the table as ``<name>.csv``, unrounded; without rows it removes that file.

        A cell with an interval becomes several columns: ``final_success``, ``final_success_low``
        and so on. Missing numbers, such as the interval of a single seed, are empty.
        """
        file = folder / f"{_plain(self.name)}.csv"
        if not self.rows:
            file.unlink(missing_ok=True)
            return
        lines = [_line(row) for row in self.rows]
        names = dict.fromkeys(name for line in lines for name in line)
        write_text(file, csv_text(lines, names))


@dataclass(frozen=True)
class Report:
    """A report: text, tables and figures.

    Attributes:
        name: the name of its Markdown file.
        title: the heading.
        parts: paragraphs and tables, in order.
        figures: file name -> title and drawing function.
        data: tables written as CSV only.
    """

    name: str
    title: str
    parts: Sequence[str | Table]
    figures: Mapping[str, tuple[str, Callable[[], Figure]]]
    data: Sequence[Table] = ()

    def __str__(self) -> str:
        """Returns the report as Markdown."""
        return "\n\n".join([f"# {self.title}", *filter(None, map(str, self.parts))]) + "\n"

    def write(self, folder: Path) -> None:
        """Writes ``<name>.md``, each table as CSV, and each figure as PNG and SVG."""
        folder.mkdir(parents=True, exist_ok=True)
        shown = [f"![{title}]({name}.png)\n" for name, (title, _) in self.figures.items()]
        write_text(folder / f"{self.name}.md", "\n".join([str(self), *shown]))
        for part in (*self.parts, *self.data):
            if isinstance(part, Table):
                part.write(folder)
        for name, (_, draw) in self.figures.items():
            figure = draw()
            for kind in ("png", "svg"):
                save(figure, folder / f"{name}.{kind}")


def _shown(cell: object) -> str:
    return f"{cell:.2f}" if type(cell) is float else str(cell)


def _line(row: Mapping[str, Any]) -> dict[str, object]:
    line: dict[str, object] = {}
    for column, cell in row.items():
        parts = cell.csv_columns() if hasattr(cell, "csv_columns") else {"": cell}
        line |= {_plain(column) + end: _kept(part) for end, part in parts.items()}
    return line


def _plain(name: str) -> str:
    """Returns a name for files and columns, such as ``final_success`` for ``final success``."""
    return re.sub(r"[^\w.]+", "_", name.lower().replace("'", "")).strip("_")


def _kept(value: object) -> object:
    is_none = value == EMPTY or (isinstance(value, float) and not math.isfinite(value))
    return "" if is_none else value


def table(head: Sequence[str], rows: Iterable[Sequence[object]], *, numbers: int = 0) -> str:
    r"""Returns a Markdown table.

    Args:
        head: the column names.
        rows: the cells; a pipe in one is escaped.
        numbers: the number of trailing columns aligned to the right.

    Examples:
        >>> print(table(("agent", "success"), [("a|b", 0.5)], numbers=1))
        | agent | success |
        | --- | ---: |
        | a\|b | 0.5 |
    """
    words = len(head) - numbers
    lines = [list(head), ["---"] * words + ["---:"] * numbers]
    lines += [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette, also for color-blind readers."""


def subplots(count: int, most: int = 3) -> tuple[Figure, list[Any]]:
    """Returns an empty figure and its panels, at most ``most`` in a row."""
    # The object interface needs no window system and has no global state.
    from matplotlib.figure import Figure

    rows = -(-count // most)
    columns = -(-count // rows)
    size = (max(8, 4 * columns), 4.5 if rows == 1 else 3.3 * rows)
    figure = Figure(figsize=size, layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for panel in panels[count:]:
        panel.remove()
    for panel in panels[:count]:
        panel.grid(alpha=0.25)
        panel.spines[["top", "right"]].set_visible(False)
    return figure, panels[:count]


def add_legend(figure: Figure) -> None:
    """Adds a legend below all panels, for which the figure grows; one column if labels are long."""
    labels = [label for panel in figure.axes for label in panel.get_legend_handles_labels()[1]]
    columns = 1 if max(map(len, labels), default=0) > 60 else 2
    figure.set_figheight(figure.get_figheight() + 0.2 * -(-len(labels) // columns))
    figure.legend(loc="outside lower center", ncols=columns, fontsize=8, frameon=False)


def draw_intervals(
    panels: Mapping[str, Mapping[str, Estimate]],
    *,
    title: str,
    limits: tuple[float, float] = (0.0, 1.0),
) -> Figure:
    """Draws estimates with their intervals, a panel for each mapping.

    Args:
        panels: heading -> label -> estimate; a missing value (NaN) leaves its row empty.
        title: the heading of the figure.
        limits: smallest and largest value shown.
    """
    figure, axes = subplots(len(panels))
    for panel, (heading, estimates) in zip(axes, panels.items(), strict=True):
        for place, found in enumerate(estimates.values()):
            ends = [[found.value - found.low], [found.high - found.value]]
            panel.errorbar(found.value, place, xerr=ends, fmt="o", color=COLORS[0], capsize=3)
        panel.set(title=heading, xlim=limits, yticks=range(len(estimates)))
        panel.set(yticklabels=list(estimates), ylim=(len(estimates) - 0.5, -0.5))
    longest = max(len(estimates) for estimates in panels.values())
    figure.set_figheight(max(figure.get_figheight(), 1.5 + 0.3 * longest))
    figure.suptitle(title)
    return figure


def save(figure: Figure, file: Path) -> None:
    """Writes a figure as PNG or SVG, by the suffix of the file."""
    picture = BytesIO()
    figure.savefig(picture, dpi=150, format=file.suffix.removeprefix("."))
    write_bytes(file, picture.getvalue())
