"""``logger=tensorboard``: TensorBoard event files in the run folder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.options.settings import option

if TYPE_CHECKING:
    from pathlib import Path

    from torchrl.record.loggers import Logger


@register
@dataclass
class TensorBoard(LoggerOption):
    """TensorBoard event files in the run folder."""

    name: str = option("tensorboard")
    package: ClassVar[str] = "tensorboard"

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes a logger that writes ``tensorboard/``."""
        from torchrl.record.loggers.tensorboard import TensorboardLogger

        return [TensorboardLogger("tensorboard", str(run_folder.resolve()))]
