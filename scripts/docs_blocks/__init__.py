"""The parts of the documentation that are made from code and from results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.docs_blocks.config import config_blocks
from scripts.docs_blocks.domain import domain_blocks
from scripts.docs_blocks.house import draw_house, house_blocks
from scripts.docs_blocks.learning import learning_blocks
from scripts.docs_blocks.policies import policies_blocks
from scripts.docs_blocks.results import draw_figures as draw_learning_curves
from scripts.docs_blocks.results import results_blocks
from scripts.docs_blocks.speed import draw_growth, speed_blocks
from scripts.docs_blocks.study import copy_figures, study_blocks
from scripts.docs_blocks.tables import table_blocks

if TYPE_CHECKING:
    from pathlib import Path

BLOCKS = (
    config_blocks,
    domain_blocks,
    house_blocks,
    learning_blocks,
    policies_blocks,
    results_blocks,
    speed_blocks,
    study_blocks,
    table_blocks,
)
"""Functions that return blocks by name; what is added here is known to every page."""

__all__ = ["BLOCKS", "draw_figures"]


def draw_figures() -> list[Path]:
    """Draws, or copies, every figure that is made from results; returns the files."""
    return [*draw_learning_curves(), *draw_growth(), *draw_house(), *copy_figures()]
