"""The loggers of a run, which end no training."""

from __future__ import annotations

import logging
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from bbq_torchrl.settings import ConfigError, walk
from bbq_torchrl.utils.files import METRICS
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from bbq_torchrl.options import Config

_LOG = logging.getLogger(__name__)


class RunLogger:
    """The loggers of a run, opened and closed by ``with``.

    At their first error they are given up with a warning, since metrics.csv has everything.

    Args:
        config: the run's configuration, which is logged.
        run_folder: the run folder.

    Raises:
        ConfigError: the loggers cannot be made.
    """

    def __init__(self, config: Config, run_folder: Path) -> None:
        self._config, self._option, self._works = config, config.logger, True
        try:
            made = self._option.make(run_folder, resume=config.resume is not None)
        except Exception as error:
            raise ConfigError(f"logger={self._option.name} cannot begin: {error}") from error
        self._loggers = tuple(made)

    def __enter__(self) -> RunLogger:
        flat = {key: value for key, _, value in walk(self._config) if key != "resume"}
        self._try(self._option.log_config, self._loggers, flat)
        return self

    def log_metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Logs the metrics of a round."""
        self._try(self._option.log_round, self._loggers, metrics, round=step)

    def log_result(self, result: Mapping[str, float], rounds: int) -> None:
        """Logs the numbers of the final result."""
        self._try(self._option.log_result, self._loggers, result, rounds=rounds)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._works:
            self._try(self._option.close, self._loggers, finished=kind is None)
        else:
            with suppress(Exception):
                self._option.close(self._loggers, finished=False)

    def _try(self, log: Callable[..., object], *given: Any, **more: Any) -> None:
        try:
            if self._works:
                log(*given, **more)
        except Exception as error:
            self._works = False
            _LOG.warning(
                "logger=%s failed and is given up, %s has everything: %s",
                *(self._option.name, METRICS, sentence(error)),
            )
