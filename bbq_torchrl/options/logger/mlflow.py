"""``logger=mlflow``: MLflow, a database in the run folder."""

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
