"""The parts of the documentation that are made from code and from results.

A module declares its blocks, by :func:`~scripts.docs_blocks.common.block`, as it is imported here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.docs_blocks import claims, config, domain, house, learning, results, speed, tables
from scripts.docs_blocks.common import BLOCKS

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["BLOCKS", "claims", "config", "domain", "draw_figures", "learning", "tables"]


def draw_figures() -> list[Path]:
    """Draws, or copies, every figure that is made from results; returns the files."""
    made = [speed.draw_growth(), house.draw_house(), *tables.copy_figures()]
    return [*results.draw_figures(), *made]
