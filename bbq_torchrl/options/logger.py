"""The options of ``logger=``: destinations of metrics besides metrics.csv.

A logger receives the configuration, a row for each round and the final result. It is closed at the
end of the run, also after an error; the next run in the process makes a new one. A logger that
fails during the run is given up with one warning.

A resumed run repeats the rounds since its last checkpoint and logs them again. TensorBoard shows
such a round twice, W&B continues the same run, and MLflow starts a new run in the same experiment.
"""

from __future__ import annotations

import importlib.util
import logging
import os
from abc import abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from getpass import getuser
from hashlib import md5
from pathlib import Path
from tempfile import gettempdir
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.settings import ANY_TEXT, ConfigError, option, setting, walk
from bbq_torchrl.utils.files import METRICS, write_text
from bbq_torchrl.utils.output import install_command, sqlite_url
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from torchrl.record.loggers import Logger

_LOG = logging.getLogger(__name__)


@dataclass
class LoggerOption(Option):
    """A destination of metrics besides metrics.csv, which is always written."""

    group: ClassVar[str] = "logger"

    package: ClassVar[str] = ""
    """The package that the logger needs; for ours also the name of its extra. May be empty."""

    @abstractmethod
    def make(self, run_folder: Path, *, resume: bool = False) -> Logger | None:
        """Makes the TorchRL logger of a run.

        Args:
            run_folder: its output folder.
            resume: whether the run continues one of an earlier process.
        """

    def log_config(self, logger: Logger, config: Mapping[str, Any]) -> None:
        """Logs the configuration, before the first round.

        Args:
            logger: the logger of :meth:`make`.
            config: values by dotted key, such as ``agent.lr``.
        """
        logger.log_hparams(dict(config))

    def log_round(self, logger: Logger, metrics: Mapping[str, float], *, round: int) -> None:
        """Logs the metrics of a round.

        Args:
            logger: the logger of :meth:`make`.
            metrics: the metrics by name, such as ``success_rate/replica_0``.
            round: the round, counted from 0.
        """
        logger.log_metrics(dict(metrics), step=round)

    def log_result(self, logger: Logger, result: Mapping[str, float], *, rounds: int) -> None:
        """Logs the final result.

        Args:
            logger: the logger of :meth:`make`.
            result: the numbers of ``result.json``, such as ``result/success_rate``.
            rounds: rounds of the training, which is the step of the result.
        """
        logger.log_metrics(dict(result), step=rounds)

    def close(self, logger: Logger, *, finished: bool) -> None:
        """Closes the logger. Called once for each run, also after an error.

        Args:
            logger: the logger of :meth:`make`.
            finished: whether the run has a result.
        """
        logger.close()

    def reach(self) -> None:
        """Reaches the server or database of the logger; any error refuses the run."""

    def check_ready(self) -> None:
        """Refuses a logger that cannot be used here and now, before a folder exists.

        Raises:
            ConfigError: the package is missing, and the message has the command that installs it;
                or :meth:`reach` failed.
        """
        if self.package and importlib.util.find_spec(self.package) is None:
            is_ours = type(self).__module__ == __name__
            command = install_command(self.package) if is_ours else f"pip install {self.package}"
            raise ConfigError(f"logger={self.name} needs the package {self.package}: {command}")
        try:
            self.reach()
        except Exception as error:
            raise ConfigError(f"logger={self.name} cannot be used: {sentence(error)}") from error


@register
@dataclass
class CSV(LoggerOption):
    """metrics.csv only."""

    name: str = option("csv")

    def make(self, run_folder: Path, *, resume: bool = False) -> Logger | None:
        """Makes no logger: metrics.csv is always written."""
        return None


@register
@dataclass
class TensorBoard(LoggerOption):
    """TensorBoard event files in the run folder."""

    name: str = option("tensorboard")
    package: ClassVar[str] = "tensorboard"

    def make(self, run_folder: Path, *, resume: bool = False) -> Logger | None:
        """Makes a logger that writes ``tensorboard/``."""
        from torchrl.record.loggers.tensorboard import TensorboardLogger

        return TensorboardLogger("tensorboard", str(run_folder.resolve()))

    def log_config(self, logger: Logger, config: Mapping[str, Any]) -> None:
        """Logs the configuration as a text; as hyper-parameters it would be a separate run."""
        text = "\n".join(f"    {key}: {value}" for key, value in config.items())
        logger.experiment.add_text("config", text)


@register
@dataclass
class WandB(LoggerOption):
    """Weights & Biases."""

    name: str = option("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project of the run")
    package: ClassVar[str] = "wandb"

    def reach(self) -> None:
        """Logs in, unless W&B is offline or disabled."""
        import wandb

        if wandb.setup().settings.mode == "online":
            wandb.login(verify=True)

    def make(self, run_folder: Path, *, resume: bool = False) -> Logger | None:
        """Makes a logger that writes ``wandb/`` and the run's id, which a resumed run reuses."""
        from torchrl.record.loggers.wandb import WandbLogger

        folder = run_folder.resolve()
        run_id = folder / "wandb" / "run_id.txt"
        run_id.parent.mkdir(parents=True, exist_ok=True)
        same = (
            {"id": run_id.read_text().strip(), "resume": "must"}
            if resume and run_id.is_file()
            else {}
        )
        logger = WandbLogger(
            folder.name,
            log_dir=str(folder),
            project=self.project,
            log_env_packages=False,  # it would use the key "env", which our configuration has
            **same,
        )
        write_text(run_id, str(logger.experiment.id))
        logger.experiment.define_metric("*", step_metric="round")
        return logger

    def log_round(self, logger: Logger, metrics: Mapping[str, float], *, round: int) -> None:
        """Logs the metrics over the round; TorchRL would add a chart of steps for each."""
        logger.experiment.log({**metrics, "round": round})

    def log_result(self, logger: Logger, result: Mapping[str, float], *, rounds: int) -> None:
        """Adds the final result to the summary; the history has the rounds."""
        logger.experiment.summary.update(dict(result))

    def close(self, logger: Logger, *, finished: bool) -> None:
        """Ends W&B's run, as failed if it has no result."""
        logger.experiment.finish(exit_code=int(not finished))


_ADDRESS = "MLFLOW_TRACKING_URI"
"""MLflow's variable for the address of a server or database; MLflow also sets it."""

_DEFAULTS = {
    "MLFLOW_SQLALCHEMYSTORE_POOLCLASS": "NullPool",  # a pool leaves the database open after the run
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "3",  # ten seconds; MLflow's 7 are four minutes
}
"""MLflow's variables -> our defaults."""


@register
@dataclass
class MLFlow(LoggerOption):
    """MLflow, at MLFLOW_TRACKING_URI or in a database in the run folder."""

    name: str = option("mlflow")
    experiment: str = setting("bbq-torchrl", ANY_TEXT, "experiment of the run")
    package: ClassVar[str] = "mlflow"

    def reach(self) -> None:
        """Makes the experiment, and the tables of a new database, if an address is given.

        One process at a time, as MLflow's migrations fail if two make the tables.
        """
        for name, value in _DEFAULTS.items():
            os.environ.setdefault(name, value)
        if not (address := os.environ.get(_ADDRESS)):
            return
        from filelock import FileLock
        from mlflow import MlflowClient

        place = md5(f"{getuser()} {address}".encode(), usedforsecurity=False).hexdigest()
        with FileLock(Path(gettempdir()) / f"bbq_torchrl-mlflow-{place}.lock"):
            client = MlflowClient(address)
            if client.get_experiment_by_name(self.experiment) is None:
                client.create_experiment(self.experiment)

    def make(self, run_folder: Path, *, resume: bool = False) -> Logger | None:
        """Starts a run, in ``mlflow.db`` unless the environment has another address."""
        import mlflow
        from torchrl.record.loggers.mlflow import MLFlowLogger

        folder = run_folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        given = os.environ.get(_ADDRESS)
        logger = MLFlowLogger(self.experiment, given or sqlite_url(folder / "mlflow.db"))
        if not given:
            os.environ.pop(_ADDRESS, None)  # set by MLflow; the next run has another database
        mlflow.set_tag("mlflow.runName", folder.name)
        return logger

    def close(self, logger: Logger, *, finished: bool) -> None:
        """Ends MLflow's run, and restores MLflow's address."""
        import mlflow

        mlflow.end_run("FINISHED" if finished else "FAILED")
        if not os.environ.get(_ADDRESS):
            default: Any = None  # accepted by MLflow, but not by its type hints
            mlflow.set_tracking_uri(default)


class RunLogger:
    """The logger of a run, opened and closed by ``with``.

    At its first error it is given up with a warning, since metrics.csv has everything.

    Args:
        config: the run's configuration, which is logged.
        run_folder: the run folder.

    Raises:
        ConfigError: the logger cannot be made.
    """

    def __init__(self, config: Any, run_folder: Path) -> None:
        self._config, self._option = config, config.logger
        try:
            self._logger = self._option.make(run_folder, resume=config.resume is not None)
        except Exception as error:
            raise ConfigError(f"logger={self._option.name} cannot begin: {error}") from error

    def __enter__(self) -> RunLogger:
        flat = {key: value for key, _, value in walk(self._config) if key != "resume"}
        self._try(self._option.log_config, flat)
        return self

    def log_round(self, _: object, rows: Sequence[Mapping[str, float]]) -> None:
        """Logs the metrics of a round, a callback of the trainer; NaN is left out."""
        metrics = {
            f"{name}/replica_{row['replica']}": float(value)
            for row in rows
            for name, value in row.items()
            if name not in ("round", "replica") and value == value
        }
        self._try(self._option.log_round, metrics, round=rows[0]["round"])

    def log_result(self, result: Mapping[str, float], rounds: int) -> None:
        """Logs the numbers of the final result."""
        self._try(self._option.log_result, result, rounds=rounds)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._try(self._option.close, finished=kind is None)

    def _try(self, log: Callable[..., object], *given: Any, **more: Any) -> None:
        if (logger := self._logger) is None:
            return
        try:
            log(logger, *given, **more)
        except Exception as error:
            self._logger = None
            with suppress(Exception):
                self._option.close(logger, finished=False)
            _LOG.warning(
                "logger=%s failed and is given up, %s has everything: %s",
                *(self._option.name, METRICS, sentence(error)),
            )
