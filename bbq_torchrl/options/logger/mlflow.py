"""``logger=mlflow``: MLflow, on its server or in a database in the run folder."""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.extras import sqlite_url
from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.options.settings import ANY_TEXT, option, setting

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from torchrl.record.loggers import Logger

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
