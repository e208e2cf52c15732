"""The parts of the documentation that are made from code and from results."""

from __future__ import annotations

from scripts.docs_blocks.config import config_blocks
from scripts.docs_blocks.deep_sea import deep_sea_blocks
from scripts.docs_blocks.dialogues import dialogues_blocks
from scripts.docs_blocks.domain import domain_blocks
from scripts.docs_blocks.policies import policies_blocks
from scripts.docs_blocks.results import draw_figures, results_blocks
from scripts.docs_blocks.speed import speed_blocks

BLOCKS = (
    config_blocks,
    deep_sea_blocks,
    dialogues_blocks,
    domain_blocks,
    policies_blocks,
    results_blocks,
    speed_blocks,
)
"""Functions that return blocks by name; what is added here is known to every page."""

__all__ = ["BLOCKS", "draw_figures"]
