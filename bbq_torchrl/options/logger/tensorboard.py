"""``logger=tensorboard``: TensorBoard event files in the run folder."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.options.settings import ConfigError, option
from bbq_torchrl.run_folder import is_utf8
from bbq_torchrl.text import shown

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
        """Makes a logger that writes ``tensorboard/``.

        Raises:
            ConfigError: the folder has a name that TensorBoard would take for another one.
        """
        from torchrl.record.loggers.tensorboard import TensorboardLogger

        folder = run_folder.resolve()
        if not is_utf8(folder):
            raise ConfigError(
                "logger=tensorboard needs a run folder whose name is UTF-8, got "
                f"{shown(str(folder))} in the encoding {sys.getfilesystemencoding()}: set a locale "
                "of UTF-8, such as LC_ALL=C.UTF-8"
            )
        return [TensorboardLogger("tensorboard", str(folder))]

    def log_config(self, loggers: Iterable[Logger], config: Mapping[str, Any]) -> None:
        """Adds the configuration as a text; as hyper-parameters it would be another run."""
        text = "\n".join(f"    {key}: {value}" for key, value in config.items())
        for logger in loggers:
            logger.experiment.add_text("config", text)
