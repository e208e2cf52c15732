"""``logger=``: where metrics go besides metrics.csv."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

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
    """CSV files only."""

    name: str = option("csv")


@register
@dataclass
class TensorBoard(LoggerOption):
    """TensorBoard event files in the run folder."""

    name: str = option("tensorboard")


@register
@dataclass
class WandB(LoggerOption):
    """Weights & Biases."""

    name: str = option("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project that the run is listed under")

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes TorchRL's loggers of a run, of the project."""
        from bbq_torchrl.trainers import make_loggers

        return make_loggers(["wandb"], run_folder, resume=resume, wandb_project=self.project)


@register
@dataclass
class MLFlow(LoggerOption):
    """MLflow, a database in the run folder."""

    name: str = option("mlflow")
