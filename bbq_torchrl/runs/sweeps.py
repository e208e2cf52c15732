"""The jobs of a sweep, and the table of its runs."""

from __future__ import annotations

import logging
import math
from typing import TYPE_CHECKING, Any

from bbq_torchrl.options import Config
from bbq_torchrl.runs.compose import to_config
from bbq_torchrl.runs.folders import finished_result, is_finished, restarted_config, run_config
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.files import HYDRA, LOG, OVERRIDES, numbers_in_order, read_yaml
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from omegaconf import DictConfig

    from bbq_torchrl.evaluation.run_result import RunResult

_LOG = logging.getLogger(__name__)
_HEAD = ("run", "overrides", "final success", "state")
_FINISHED = "finished"


def run_job(composed: DictConfig, folder: Path, run: Callable[..., RunResult]) -> float:
    """Runs a job of a sweep, which continues the run in its folder, if any.

    A job that fails is logged and leaves the others alone.

    Args:
        composed: the configuration of the job.
        folder: its run folder.
        run: :func:`bbq_torchrl.runs.train.run`.

    Returns:
        The final success rate, for sweepers; not a number if the job failed or was interrupted.
    """
    from bbq_torchrl.runs import build  # torch and torchrl take ten seconds

    output.escape()
    interruption.listen()
    interruption.end_with_parent()
    try:
        interruption.check()
        config = to_config(composed, Config)
        if config.resume is not None:
            raise ConfigError("resume cannot be combined with --multirun")
        config = restarted_config(config, folder)
        result = finished_result(folder, config.protocol.rounds)
        if result is None or not is_finished(folder, config.protocol.rounds):
            build.check_resources(config)
            result = run(config, folder)
        return result.success_rate
    except interruption.Interrupted:
        pass
    except Exception as error:
        is_foreseen = isinstance(error, build.FORESEEN)
        _LOG.error("this run failed: %s", sentence(error), exc_info=not is_foreseen)
    return math.nan


def has_failed(sweep: Path) -> bool:
    """Returns whether a run of a sweep is not finished."""
    return any(_success_and_state(folder)[1] != _FINISHED for folder in _runs_of(sweep))


def table_of_runs(sweep: Path) -> str:
    """Returns a line for each run of a sweep: folder, overrides, final success, state.

    Overrides that all runs share are left out.
    """
    folders = _runs_of(sweep)
    overrides = [_overrides(folder) for folder in folders]
    shared = set(overrides[0]).intersection(*overrides) if len(overrides) > 1 else set()
    rows = [
        (
            str(folder.relative_to(sweep)),
            " ".join(item for item in given if item not in shared),
            *_success_and_state(folder),
        )
        for folder, given in zip(folders, overrides, strict=True)
    ]
    finished = sum(state == _FINISHED for *_, state in rows)
    table = [_HEAD, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    )
    return "\n".join([f"{finished} of {len(rows)} runs in {sweep} are finished", *lines])


def _runs_of(sweep: Path) -> list[Path]:
    folders = (file.parent for file in sweep.rglob(HYDRA))
    return sorted(folders, key=numbers_in_order)


def _success_and_state(folder: Path) -> tuple[str, str]:
    try:
        rounds = run_config(folder).protocol.rounds
    except ConfigError:
        rounds = 0
    result = finished_result(folder, rounds)
    if result is not None and is_finished(folder, rounds):
        return f"{result.success_rate:.3f}", _FINISHED
    return "–", f"not finished: {LOG} in it says why"


def _overrides(folder: Path) -> list[str]:
    """Returns the overrides in Hydra's file of a run; empty if it cannot be read."""
    try:
        noted: Any = read_yaml((folder / OVERRIDES).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [item for item in noted if isinstance(item, str)] if isinstance(noted, list) else []
