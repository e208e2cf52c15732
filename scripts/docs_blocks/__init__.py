"""Generated blocks of the documentation.

Importing a module here registers its blocks by :func:`~scripts.docs_blocks.common.block`.
"""

from __future__ import annotations

from scripts.docs_blocks import (  # noqa: F401
    best,
    config,
    domain,
    files,
    house,
    learning,
    results,
    speed,
    story,
    tables,
)
from scripts.docs_blocks.common import BLOCKS

__all__ = ["BLOCKS", "draw_figures"]


def draw_figures() -> None:
    """Draws or copies all generated figures."""
    results.draw_figures()
    results.write_claims()
    speed.draw_growth()
    house.draw_house()
