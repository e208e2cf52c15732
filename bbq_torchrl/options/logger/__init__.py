"""The options of ``logger=``: where metrics go besides metrics.csv.

A resumed run plays the rounds since its last checkpoint again, and logs them again: TensorBoard
shows such a round twice, W&B goes on as the same run, and MLflow begins a new run in the same
experiment.
"""

from __future__ import annotations

import importlib.util
from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.extras import install_command
from bbq_torchrl.options.base import Option
from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from torchrl.record.loggers import Logger

__all__ = ["LoggerOption"]


@dataclass
class LoggerOption(Option):
    """Where metrics go besides metrics.csv, which is always written."""

    group: ClassVar[str] = "logger"

    package: ClassVar[str] = ""
    """What has to be installed, and for ours the extra that brings it; empty: nothing."""

    @abstractmethod
    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes TorchRL's loggers of a run.

        Args:
            run_folder: where they write.
            resume: whether the run goes on from an earlier process.
        """

    def check_package(self) -> None:
        """Raises ConfigError, which says what to install, where the package is missing."""
        if self.package and importlib.util.find_spec(self.package) is None:
            is_ours = type(self).__module__.startswith(f"{__name__}.")
            command = install_command(self.package) if is_ours else f"pip install {self.package}"
            raise ConfigError(f"logger={self.name} needs the package {self.package}: {command}")
