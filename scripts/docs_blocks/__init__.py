"""The parts of the documentation that are made from code and from results.

A module declares its blocks, by :func:`~scripts.docs_blocks.common.block`, as it is imported here.
"""

from __future__ import annotations

from scripts.docs_blocks import config, domain, files, house, results, speed, story, tables
from scripts.docs_blocks.common import BLOCKS

__all__ = ["BLOCKS", "config", "domain", "draw_figures", "story", "tables"]


def draw_figures() -> None:
    """Draws, or copies, every figure that is made from results."""
    results.draw_figures()
    speed.draw_growth()
    house.draw_house()
    files.copy_figures()
