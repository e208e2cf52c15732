"""``logger=tensorboard``: TensorBoard event files in the run folder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.options.settings import option

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
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

    def log_config(self, loggers: Iterable[Logger], config: Mapping[str, Any]) -> None:
        """Adds the configuration as a text; as hyper-parameters it would be another run."""
        text = "\n".join(f"    {key}: {value}" for key, value in config.items())
        for logger in loggers:
            logger.experiment.add_text("config", text)
