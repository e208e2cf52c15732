"""``logger=``: where metrics go besides metrics.csv.

A resumed run plays the rounds since its last checkpoint again, and logs them again: TensorBoard
shows such a round twice, W&B goes on as the same run, and MLflow begins a new run in the same
experiment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import LoggerOption
from bbq_torchrl.options.registry import register
from bbq_torchrl.options.settings import ANY_TEXT, option, setting

if TYPE_CHECKING:
    from pathlib import Path

    from torchrl.record.loggers import Logger

__all__ = ["CSV", "MLFlow", "TensorBoard", "WandB"]


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
        """Makes a logger that writes ``tensorboard/``."""
        from torchrl.record.loggers.tensorboard import TensorboardLogger

        return [TensorboardLogger("tensorboard", str(run_folder.resolve()))]


@register
@dataclass
class WandB(LoggerOption):
    """Weights & Biases."""

    name: str = option("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project that the run is listed under")
    package: ClassVar[str] = "wandb"

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes a logger that writes ``wandb/``, with the id by which a resumed run is the same."""
        from torchrl.record.loggers.wandb import WandbLogger

        folder = run_folder.resolve()
        run_id = folder / "wandb" / "run_id.txt"
        run_id.parent.mkdir(parents=True, exist_ok=True)
        same = (
            {"id": run_id.read_text().strip(), "resume": "must"}
            if resume and run_id.is_file()
            else {}
        )
        logger = WandbLogger(folder.name, log_dir=str(folder), project=self.project, **same)
        run_id.write_text(str(logger.experiment.id))
        return [logger]


@register
@dataclass
class MLFlow(LoggerOption):
    """MLflow, a database in the run folder."""

    name: str = option("mlflow")
    package: ClassVar[str] = "mlflow"

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes a logger that writes ``mlflow.db`` (MLflow has no file store since 3.10)."""
        from torchrl.record.loggers.mlflow import MLFlowLogger

        folder = run_folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        return [MLFlowLogger(folder.name, tracking_uri=f"sqlite:///{folder / 'mlflow.db'}")]
