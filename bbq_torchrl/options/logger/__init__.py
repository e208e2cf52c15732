"""The options of ``logger=``: where metrics go besides metrics.csv.

A logger gets the configuration, a row each round and the final result, and is closed when the run
ends, however it ends: the next run of the process begins with a new one.

A resumed run plays the rounds since its last checkpoint again, and logs them again: TensorBoard
shows such a round twice, W&B continues the same run, and MLflow begins a new run in the same
experiment.
"""

from __future__ import annotations

import importlib.util
from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.extras import install_command
from bbq_torchrl.options.base import Option
from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
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

    def log_config(self, loggers: Iterable[Logger], config: Mapping[str, Any]) -> None:
        """Hands the configuration to the loggers, before the first round.

        Args:
            loggers: those of :meth:`make`.
            config: value by dotted key, such as ``agent.lr``.
        """
        for logger in loggers:
            logger.log_hparams(dict(config))

    def log_result(
        self, loggers: Iterable[Logger], result: Mapping[str, float], *, rounds: int
    ) -> None:
        """Hands the final result to the loggers.

        Args:
            loggers: those of :meth:`make`.
            result: the numbers of ``result.json``, such as ``result/success_rate``.
            rounds: rounds of the training, the step that the result is logged at.
        """
        for logger in loggers:
            logger.log_metrics(dict(result), step=rounds)

    def close(self, loggers: Iterable[Logger], *, finished: bool) -> None:
        """Ends the loggers. Called once for each run, after an error too.

        Args:
            loggers: those of :meth:`make`.
            finished: whether the run came to its result.
        """
        for logger in loggers:
            logger.close()

    def check_ready(self) -> None:
        """Refuses a logger that cannot be used here, before anything runs.

        Raises:
            ConfigError: the package is missing; the error says how to install it.
        """
        if self.package and importlib.util.find_spec(self.package) is None:
            is_ours = type(self).__module__.startswith(f"{__name__}.")
            command = install_command(self.package) if is_ours else f"pip install {self.package}"
            raise ConfigError(f"logger={self.name} needs the package {self.package}: {command}")
