"""The parts of the documentation that are made from code and from results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scripts.docs_blocks.adversary import adversary_blocks
from scripts.docs_blocks.config import config_blocks
from scripts.docs_blocks.deep_sea import deep_sea_blocks
from scripts.docs_blocks.dialogues import dialogues_blocks
from scripts.docs_blocks.domain import domain_blocks
from scripts.docs_blocks.extending import extending_blocks
from scripts.docs_blocks.floor import floor_blocks
from scripts.docs_blocks.growth import draw_growth, growth_blocks
from scripts.docs_blocks.house import draw_house, house_blocks
from scripts.docs_blocks.language import language_blocks
from scripts.docs_blocks.learning import learning_blocks
from scripts.docs_blocks.policies import policies_blocks
from scripts.docs_blocks.results import draw_figures as draw_learning_curves
from scripts.docs_blocks.results import results_blocks
from scripts.docs_blocks.speed import speed_blocks

if TYPE_CHECKING:
    from pathlib import Path

BLOCKS = (
    adversary_blocks,
    config_blocks,
    deep_sea_blocks,
    dialogues_blocks,
    domain_blocks,
    extending_blocks,
    floor_blocks,
    growth_blocks,
    house_blocks,
    language_blocks,
    learning_blocks,
    policies_blocks,
    results_blocks,
    speed_blocks,
)
"""Functions that return blocks by name; what is added here is known to every page."""

__all__ = ["BLOCKS", "draw_figures"]


def draw_figures() -> list[Path]:
    """Draws every figure that is made from results; returns the files."""
    return [*draw_learning_curves(), *draw_growth(), *draw_house()]
