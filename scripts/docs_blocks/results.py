"""Tables and figures of measured numbers, from the files in results/."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["results_blocks"]


def results_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks of measured numbers."""
    return {}
