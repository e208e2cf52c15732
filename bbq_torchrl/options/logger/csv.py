"""``logger=csv``: metrics.csv only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.options.settings import option

if TYPE_CHECKING:
    from pathlib import Path

    from torchrl.record.loggers import Logger


@register
@dataclass
class CSV(LoggerOption):
    """metrics.csv only."""

    name: str = option("csv")

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes none: metrics.csv is written whatever the logger."""
        return []
