"""The options of ``logger=``: destinations of metrics besides metrics.csv.

A logger gets the configuration, a row each round and the final result, and is closed when the run
ends, however it ends: the next run of the process begins with a new one.

A resumed run plays the rounds since its last checkpoint again, and logs them again: TensorBoard
shows such a round twice, W&B continues the same run, and MLflow begins a new run in the same
experiment.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from abc import abstractmethod
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.settings import ANY_TEXT, ConfigError, option, setting
from bbq_torchrl.utils.extras import install_command, sqlite_url
from bbq_torchrl.utils.files import is_utf8, write_text
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from torchrl.record.loggers import Logger


@dataclass
class LoggerOption(Option):
    """A destination of metrics besides metrics.csv, which is always written."""

    group: ClassVar[str] = "logger"

    package: ClassVar[str] = ""
    """The package to install, for ours also the extra that installs it; empty: none."""

    @abstractmethod
    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes TorchRL's loggers of a run.

        Args:
            run_folder: where they write.
            resume: whether the run continues that of an earlier process.
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
            is_ours = type(self).__module__ == __name__
            command = install_command(self.package) if is_ours else f"pip install {self.package}"
            raise ConfigError(f"logger={self.name} needs the package {self.package}: {command}")


@register
@dataclass
class CSV(LoggerOption):
    """metrics.csv only."""

    name: str = option("csv")

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes none: metrics.csv is written whatever the logger."""
        return []


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


_HOST = "https://api.wandb.ai"
"""W&B's own server, whose key W&B takes for the other names of it."""


@register
@dataclass
class WandB(LoggerOption):
    """Weights & Biases."""

    name: str = option("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project that the run is listed under")
    package: ClassVar[str] = "wandb"

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes a logger that writes ``wandb/``, with the id by which a resumed run is the same."""
        import wandb
        from torchrl.record.loggers.wandb import WandbLogger

        folder = run_folder.resolve()
        run_id = folder / "wandb" / "run_id.txt"
        run_id.parent.mkdir(parents=True, exist_ok=True)
        same = (
            {"id": run_id.read_text().strip(), "resume": "must"}
            if resume and run_id.is_file()
            else {}
        )
        try:
            logger = WandbLogger(
                folder.name,
                log_dir=str(folder),
                project=self.project,
                log_env_packages=False,  # its key would be "env", and our environment has those
                **same,
            )
        except wandb.Error as error:
            raise ConfigError(f"logger=wandb cannot begin a run: {sentence(error)}") from error
        write_text(run_id, str(logger.experiment.id))
        return [logger]

    def log_result(
        self, loggers: Iterable[Logger], result: Mapping[str, float], *, rounds: int
    ) -> None:
        """Puts the final result into the summary: the history has a row each round."""
        for logger in loggers:
            logger.experiment.summary.update(dict(result))

    def close(self, loggers: Iterable[Logger], *, finished: bool) -> None:
        """Ends W&B's run, as failed unless it came to its result."""
        for logger in loggers:
            logger.experiment.finish(exit_code=int(not finished))

    def check_ready(self) -> None:
        """Refuses W&B without its package, and without a key unless it is offline."""
        super().check_ready()
        import wandb
        from requests.utils import get_netrc_auth  # comes with wandb

        if wandb.run is not None:
            return  # W&B has begun a run already, which teardown would end
        try:
            settings = wandb.setup().settings
        finally:
            wandb.teardown()  # jobs on other machines must not look for the service of this one
        is_offline = settings.mode in ("offline", "dryrun", "disabled")
        given = settings.api_key or os.environ.get("WANDB_IDENTITY_TOKEN_FILE")
        if not (is_offline or given or any(map(get_netrc_auth, (settings.base_url, _HOST)))):
            raise ConfigError(
                "logger=wandb needs an API key of W&B: run `wandb login`, set WANDB_API_KEY, or "
                "log offline by WANDB_MODE=offline"
            )


_ADDRESS = "MLFLOW_TRACKING_URI"
"""MLflow's variable for the address of a server or of a database, which MLflow itself sets too."""

_POOL = "MLFLOW_SQLALCHEMYSTORE_POOLCLASS"
"""MLflow's variable for what keeps connections to a database open."""


@register
@dataclass
class MLFlow(LoggerOption):
    """MLflow, at MLFLOW_TRACKING_URI or in a database in the run folder."""

    name: str = option("mlflow")
    experiment: str = setting("bbq-torchrl", ANY_TEXT, "experiment that the run is listed under")
    package: ClassVar[str] = "mlflow"

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Begins a run, in ``mlflow.db`` unless the environment has another address."""
        import mlflow
        from torchrl.record.loggers.mlflow import MLFlowLogger

        folder = run_folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        given = os.environ.get(_ADDRESS)
        with _unchanged(_ADDRESS, _POOL):
            if not given:
                os.environ[_POOL] = "NullPool"  # else the database stays open after the run
            logger = MLFlowLogger(self.experiment, given or sqlite_url(folder / "mlflow.db"))
        mlflow.set_tag("mlflow.runName", folder.name)
        return [logger]

    def close(self, loggers: Iterable[Logger], *, finished: bool) -> None:
        """Ends MLflow's run, and leaves MLflow as it was found."""
        import mlflow

        mlflow.end_run("FINISHED" if finished else "FAILED")
        if not os.environ.get(_ADDRESS):
            nothing: Any = None  # which MLflow takes, though it does not say so
            mlflow.set_tracking_uri(nothing)


@contextmanager
def _unchanged(*names: str) -> Iterator[None]:
    """Restores variables of the environment, which the next run of the process reads."""
    before = {name: os.environ.get(name) for name in names}
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
