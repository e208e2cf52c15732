"""The last figures of tests/adversary, from results/adversary.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from scripts.docs_blocks.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["adversary_blocks"]

FILE = Path(__file__).resolve().parents[2] / "results" / "adversary.json"
MAKE = "BBQ_RECORD=results/adversary.json scripts/check adversary"


def adversary_blocks() -> dict[str, Callable[[], str]]:
    """Returns the block of what was done to runs, and what became of them."""
    return {"adversary": _outcomes}


def _outcomes() -> str:
    if not FILE.is_file():
        return f"Not measured yet; `{MAKE}` does."
    found = json.loads(FILE.read_text(encoding="utf-8"))
    rows = [(*name.split(": ", 1), times) for name, times in found["outcomes"].items()]
    head = ("tried", "what came of it", "times")
    return (
        f"{table(head, rows, numbers=1)}\n\n```bash\n"
        f"BBQ_RECORD=results/adversary.json {found['command']}\n```"
    )
