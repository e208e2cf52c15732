"""TorchRL's loggers for a run folder."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Any, Literal, get_args

from torchrl.record.loggers import CSVLogger, Logger, get_logger

from bbq_torchrl.extras import install_command
from bbq_torchrl.trainers.metrics import MetricRow, replace_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

__all__ = ["LoggerName", "check_logger", "log_rows", "make_loggers", "trim_scalars"]

LoggerName = Literal["csv", "tensorboard", "wandb", "mlflow"]


def make_loggers(
    names: Iterable[LoggerName],
    run_folder: Path,
    *,
    resume: bool = False,
    wandb_project: str = "bbq-torchrl",
) -> list[Logger]:
    """Returns TorchRL loggers that write into a run folder; CSV is always the first of them.

    CSV writes ``scalars/<name>.csv`` (``step,value``), TensorBoard ``tensorboard/``, W&B
    ``wandb/`` (a resumed run goes on as the same W&B run), and MLflow ``mlflow.db``, a SQLite
    database (its file store is gone since 3.10).

    A resumed run plays the rounds since its last checkpoint again. ``metrics.csv`` and ``scalars/``
    are set back to the checkpoint; TensorBoard shows such a round twice, and MLflow begins a new
    run in the same experiment.

    Args:
        names (iterable of str): any of ``"csv"``, ``"tensorboard"``, ``"wandb"``, ``"mlflow"``.
        run_folder (Path): the run folder.
        resume (bool): whether the run goes on from an earlier process. Default: ``False``.
        wandb_project (str): the W&B project. Default: ``"bbq-torchrl"``.

    Raises:
        ValueError: if a name is unknown.
        ImportError: if a logger's package is missing; names the extra to install.
    """
    chosen = list(dict.fromkeys(["csv", *names]))
    for name in chosen:
        check_logger(name)
    run_folder.mkdir(parents=True, exist_ok=True)
    return [_make_logger(name, run_folder, resume, wandb_project) for name in chosen]


def check_logger(name: str) -> None:
    """Checks that there is a logger of that name.

    Raises:
        ValueError: if the name is unknown.
        ImportError: if its package is missing; names the extra to install.
    """
    if name not in get_args(LoggerName):
        raise ValueError(f"logger must be one of {list(get_args(LoggerName))}, got {name!r}")
    if name != "csv" and importlib.util.find_spec(name) is None:
        raise ImportError(f"logger={name} needs the package {name}: {install_command(name)}")


def _make_logger(name: str, run_folder: Path, resume: bool, wandb_project: str) -> Logger:
    folder = run_folder.resolve()
    if name == "csv":
        logger = CSVLogger(exp_name=folder.name, log_dir=str(folder.parent))
        # TorchRL makes folders for videos and texts too; nothing here writes any.
        for empty in ("videos", "texts"):
            _remove_if_empty(folder / empty)
        return logger
    if name == "mlflow":
        from torchrl.record.loggers.mlflow import MLFlowLogger

        return MLFlowLogger(exp_name=folder.name, tracking_uri=f"sqlite:///{folder / 'mlflow.db'}")
    options: dict[str, Any] = {}
    if name == "wandb":
        run_id = folder / "wandb" / "run_id.txt"
        options = {"project": wandb_project}
        if resume and run_id.is_file():
            options |= {"id": run_id.read_text().strip(), "resume": "must"}
        run_id.parent.mkdir(exist_ok=True)
        logger = get_logger("wandb", str(folder), folder.name, wandb_kwargs=options)
        assert logger is not None
        run_id.write_text(str(logger.experiment.id))
        return logger
    logger = get_logger("tensorboard", str(folder), "tensorboard")
    assert logger is not None
    return logger


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def log_rows(loggers: Sequence[Logger], rows: Sequence[MetricRow]) -> None:
    """Logs a round's rows as ``<metric>/replica_<r>``, at the step of the round, but for NaN."""
    for logger in loggers:
        for row in rows:
            step, replica = int(row["round"]), int(row["replica"])
            for name, value in row.items():
                if name not in ("round", "replica") and value == value:
                    logger.log_scalar(f"{name}/replica_{replica}", float(value), step=step)


def trim_scalars(run_folder: Path, rounds: int) -> None:
    """Removes from ``scalars/`` what was logged in a round that a resumed run plays again."""
    for path in sorted((run_folder / "scalars").rglob("*.csv")):
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        kept = [line for line in lines if _is_before(line, rounds)]
        if kept != lines:
            replace_text(path, "".join(kept))


def _is_before(line: str, rounds: int) -> bool:
    step, comma, _ = line.partition(",")
    return bool(comma) and line.endswith("\n") and step.isdigit() and int(step) < rounds
