"""Rows of the comparison: measurements next to targets."""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Literal

import torch

from bbq_torchrl.utils.reports import table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

HEAD = ("what", "unit", "measured", "to reach", "reached", "torch")


@dataclass(frozen=True)
class Row:
    """One figure.

    Attributes:
        part: the part of the comparison that it belongs to.
        what: what was measured.
        unit: of ``measured`` and ``target``.
        measured: the figure.
        target: what it is to reach; None where it only informs.
        better: whether ``target`` is the least or the most that it may be.
        is_bound: whether ``measured`` is only a lower bound, the rest having been cut off.
        remark: shown behind ``what``.
        torch: the version that it was measured with.
    """

    part: str
    what: str
    unit: str
    measured: float
    target: float | None = None
    better: Literal["higher", "lower"] = "lower"
    is_bound: bool = False
    remark: str = ""
    torch: str = torch.__version__

    @property
    def reached(self) -> bool | None:
        """True if the target is reached; None without a target."""
        if self.target is None:
            return None
        if self.better == "higher":
            return self.measured >= self.target
        return self.measured <= self.target and not self.is_bound


def as_table(rows: Sequence[Row]) -> str:
    """Returns rows as a Markdown table."""
    lines = []
    for row in rows:
        sign = "≥" if row.better == "higher" else "≤"
        target = "–" if row.target is None else f"{sign} {number(row.target)}"
        reached = {None: "–", True: "yes", False: "no"}[row.reached]
        what = f"{row.what} ({row.remark})" if row.remark else row.what
        measured = f"> {number(row.measured)}" if row.is_bound else number(row.measured)
        lines.append((what, row.unit, measured, target, reached, row.torch))
    return table(HEAD, lines)


def number(value: float) -> str:
    """Formats a figure with three digits, or all before the point.

    Examples:
        >>> number(1234.5), number(0.98765)
        ('1,234', '0.988')
    """
    return f"{value:,.0f}" if abs(value) >= 1_000 else f"{value:.3g}"


def read(file: Path) -> dict[str, list[Row]]:
    """Returns the rows of every version in a CSV file, oldest version first."""
    found: dict[str, list[Row]] = {}
    with file.open(newline="", encoding="utf-8") as opened:
        for line in csv.DictReader(opened):
            rows = found.setdefault(line.pop("version"), [])
            target = float(line["target"]) if line["target"] else None
            given = {**line, "measured": float(line["measured"]), "target": target}
            rows.append(Row(**{**given, "is_bound": line["is_bound"] == "yes"}))
    return found


def keep(file: Path, version: str, rows: Sequence[Row]) -> None:
    """Writes rows of a version, replacing its rows of the same parts."""
    versions = read(file) if file.is_file() else {}
    measured = {row.part for row in rows}
    versions[version] = [r for r in versions.get(version, []) if r.part not in measured] + [*rows]
    with file.open("w", newline="", encoding="utf-8") as opened:
        writer = csv.writer(opened, lineterminator="\n")
        writer.writerow(("version", *(item.name for item in fields(Row))))
        for name, kept in versions.items():
            for row in kept:
                target = "" if row.target is None else f"{row.target:g}"
                measured = f"{float(format(row.measured, '.4g')):g}"
                told = (row.better, "yes" if row.is_bound else "", row.remark, row.torch)
                writer.writerow((name, row.part, row.what, row.unit, measured, target, *told))
