"""Tables of speeds: the targets, the versions, and every benchmark."""

from __future__ import annotations

import ast
import csv
import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.parts.rows import Row, as_table
from scripts.docs_blocks.markdown import code, table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["number", "speed_blocks"]

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "results" / "speed.json"
COMPARED = ROOT / "results" / "compare.json"
HISTORY = ROOT / "results" / "speed_history.csv"

_OWN = ("name", "seconds", "rounds")


def speed_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks of the targets, of the versions and of all benchmarks."""
    return {"speed": _all, "speed.targets": _targets, "speed.versions": _versions}


def _targets() -> str:
    """Returns what is to be reached beside what was measured in one run."""
    if not COMPARED.is_file():
        return "Not measured yet; `python scripts/measure_speed.py compare` does."
    report = json.loads(COMPARED.read_text(encoding="utf-8"))
    names = [item.name for item in fields(Row)]  # older files lack some, and hold `reached`
    rows = [Row(**{name: row[name] for name in names if name in row}) for row in report["rows"]]
    return f"{as_table(rows)}\n\n{_machine(report)}\n\n```bash\n{report['command']}\n```"


def _versions() -> str:
    """Returns a row for every figure, with each version's prediction and measurement."""
    with HISTORY.open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    versions = list(dict.fromkeys(line["version"] for line in lines))
    figures = {
        (line["version"], line["what"], column): line[column]
        for line in lines
        for column in ("predicted", "measured")
    }
    rows = []
    for what, unit in dict.fromkeys((line["what"], line["unit"]) for line in lines):
        texts = (
            figures.get((version, what, column), "")
            for version in versions
            for column in ("predicted", "measured")
        )
        rows.append((what, unit, *(number(float(text)) if text else "–" for text in texts)))
    head = [f"{version} {column}" for version in versions for column in ("predicted", "measured")]
    return table(("what", "unit", *head), rows, numbers=len(head))


def _all() -> str:
    """Returns a section for every file of benchmarks, headed by its first line."""
    measured = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    return "\n\n".join(
        f"### {_title(path)}\n\n{_times(path.stem, measured)}"
        for path in sorted((ROOT / "benchmarks").glob("bench_*.py"))
    )


def _title(path: Path) -> str:
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or path.stem
    return docstring.splitlines()[0].rstrip(".")


def _times(name: str, measured: dict[str, Any]) -> str:
    if name not in measured:
        return f"Not measured yet; `python scripts/measure_speed.py {name}` does."
    report: dict[str, Any] = measured[name]
    extra = list(dict.fromkeys(key for time in report["times"] for key in time if key not in _OWN))
    rows = [
        (
            code(time["name"].removeprefix("test_")),
            number(1e3 * time["seconds"]),
            *(number(time.get(key)) for key in extra),
        )
        for time in report["times"]
    ]
    head = ("what", "ms (minimum)", *(key.replace("_", " ") for key in extra))
    return (
        f"{table(head, rows, numbers=1 + len(extra))}\n\n"
        f"{_machine(report)}\n\n```bash\n{report['command']}\n```"
    )


def _machine(report: dict[str, Any]) -> str:
    versions = ", ".join(f"{package} {text}" for package, text in report["versions"].items())
    return f"({report['processor']}, one thread; {versions})"


def number(value: object) -> str:
    """Returns a figure as it is shown: three digits, or all before the point."""
    if value is None:
        return "–"
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return str(value)
    return f"{value:,.0f}" if abs(value) >= 1_000 else f"{value:.3g}"
