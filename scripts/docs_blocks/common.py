"""What the blocks share: how one is declared, the files of results/, Markdown."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "BLOCKS",
    "FIGURES",
    "RESULTS",
    "ROOT",
    "block",
    "code",
    "read_csv",
    "read_json",
    "table",
]

ROOT = Path(__file__).resolve().parents[2]
RESULTS, FIGURES = ROOT / "results", ROOT / "docs" / "figures"

BLOCKS: dict[str, Callable[[], str]] = {}
"""Name -> what returns the block; every page may hold each of them."""


def block(name: str, *given: Any) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Makes a function the block of a name, called with what is given here."""

    def declare(function: Callable[..., str]) -> Callable[..., str]:
        BLOCKS[name] = lambda: function(*given)
        return function

    return declare


def code(text: object) -> str:
    """Returns ``text`` as inline code."""
    return f"`{text}`"


def read_csv(name: str) -> list[dict[str, str]]:
    """Returns the lines of a file in results/."""
    with (RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_json(name: str) -> Any:
    """Returns what a file in results/ holds."""
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))
