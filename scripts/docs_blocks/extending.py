"""The files of the example package of options, so that the page shows what runs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["extending_blocks"]

_PACKAGE = Path(__file__).resolve().parents[2] / "examples" / "extending" / "bbq_extending"
_SHOWN = ("ucb_policy", "ucb", "langevin", "visits", "chain")


def extending_blocks() -> dict[str, Callable[[], str]]:
    """Returns a block for each file that the page shows."""
    return {f"extending.{name}": partial(_file, name) for name in _SHOWN}


def _file(name: str) -> str:
    text = (_PACKAGE / f"{name}.py").read_text(encoding="utf-8")
    return f"```python\n{text}```"
