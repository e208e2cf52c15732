"""Tables of benchmark times, from benchmarks/ and results/speed.json."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.docs_blocks.markdown import code, table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["speed_blocks"]

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "results" / "speed.json"

_OWN = ("name", "seconds", "rounds")


def speed_blocks() -> dict[str, Callable[[], str]]:
    """Returns the block of all benchmarks."""
    return {"speed": _all}


def _all() -> str:
    """Returns a section for every file of benchmarks, headed by its first line."""
    measured = json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}
    return "\n\n".join(
        f"## {_title(path)}\n\n{_times(path.stem, measured)}"
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
            _number(1e3 * time["seconds"]),
            *(_number(time.get(key)) for key in extra),
        )
        for time in report["times"]
    ]
    head = ("what", "ms (minimum)", *(key.replace("_", " ") for key in extra))
    versions = ", ".join(f"{package} {text}" for package, text in report["versions"].items())
    return (
        f"{table(head, rows, numbers=1 + len(extra))}\n\n"
        f"({report['processor']}, one thread; {versions})\n\n```bash\n{report['command']}\n```"
    )


def _number(value: object) -> str:
    if value is None:
        return "–"
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return str(value)
    return f"{value:,.0f}" if abs(value) >= 1_000 else f"{value:.3g}"
