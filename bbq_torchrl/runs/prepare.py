"""Before a run: checks of configuration, device and domain, resuming, and the run's folder.

Hydra calls :class:`Preparation` before it makes a folder, and after a sweep, for the table of its
runs.
"""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.experimental.callback import Callback
from hydra.utils import to_absolute_path
from omegaconf import DictConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from bbq_torchrl.options import Config, validate
from bbq_torchrl.runs.compose import key_of, quoted, to_config
from bbq_torchrl.runs.folders import (
    CHANGEABLE,
    finished_result,
    is_finished,
    reserve,
    restarted_config,
    run_config,
    run_lock,
)
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.files import CONFIG, HYDRA, LOG, OVERRIDES, numbers_in_order, read_yaml
from bbq_torchrl.utils.reports import Table
from bbq_torchrl.utils.text import EMPTY, sentence, shown

if TYPE_CHECKING:
    from bbq_torchrl.evaluation.run_result import RunResult

_LOG = logging.getLogger(__name__)

_ON_THIS_MACHINE = ("cores", "joblib", "basic")
"""Launchers whose jobs are this process or its children."""


class Preparation(Callback):
    """Refuses what cannot be run before a folder exists, and prints the table of a sweep."""

    def __init__(self) -> None:
        self._locks = ExitStack()

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Checks a single run, and chooses and locks its folder."""
        with output.refusals():  # Hydra only warns of exceptions in callbacks
            prepare_run(config, self._locks)

    def on_run_end(self, config: DictConfig, **_: Any) -> None:
        """Unlocks the folder."""
        self._locks.close()

    def on_multirun_start(self, config: DictConfig, **_: Any) -> None:
        """Makes the folder of a sweep and checks its logger; each job checks its configuration."""
        with output.refusals(), read_write(config), open_dict(config):
            logger: Any = OmegaConf.to_object(config.logger)
            logger.check_ready()
            folder = Path(config.hydra.sweep.dir).absolute()  # workers start in other folders
            if "hydra.sweep.dir" not in map(key_of, config.hydra.overrides.hydra):
                folder = reserve(folder)
            config.hydra.sweep.dir = str(folder)
            config.hydra.overrides.hydra.append(f"hydra.sweep.dir={quoted(folder)}")
        _tell(folder)
        if config.hydra.runtime.choices["hydra/launcher"] in _ON_THIS_MACHINE:
            interruption.stop_by(_stop_workers)

    def on_multirun_end(self, config: DictConfig, **_: Any) -> None:
        """Prints the table of the sweep; the exit code is 1 if a run is not finished."""
        folder = Path(config.hydra.sweep.dir)
        table, is_complete = table_of_runs(folder)
        output.print_error(table)
        _tell(folder)
        if not is_complete and not interruption.exit_code():
            sys.exit(1)


def _tell(sweep: Path) -> None:
    how = f"the same command with hydra.sweep.dir={sweep} continues"
    interruption.tell(lambda: "in a sweep", lambda: how)


def _stop_workers() -> None:
    """Lets the workers of a sweep finish their rounds; without any, nothing is to be saved."""
    workers = multiprocessing.active_children()
    if not workers:
        interruption.end()
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra prints no traceback of an ended worker
    for worker in workers:
        worker.terminate()


def prepare_run(composed: DictConfig, locks: ExitStack) -> Config:
    """Checks a single run before anything is written, then chooses and locks its folder.

    Args:
        composed: the configuration with Hydra's part; the name of the folder is set in it.
        locks: the stack that releases the lock of the folder.

    Raises:
        ConfigError: one sentence that names the fault and the allowed values.
        ValueError or OSError: an unusable domain or folder.
    """
    from bbq_torchrl.runs import build  # torch and torchrl take ten seconds

    given = composed.hydra.overrides
    config = final_config(composed, given.task)
    swept = composed.hydra.sweeper.get("params") or {}
    if left := sorted(swept.keys() - set(map(key_of, given.task))):
        raise ConfigError(f"this is a sweep over {', '.join(left)}: add --multirun")
    build.check_resources(config)
    with read_write(composed), open_dict(composed):
        if config.resume is not None:
            composed.hydra.run.dir = config.resume
            composed.hydra.output_subdir = None  # as the first process wrote it
        try:
            folder = Path(composed.hydra.run.dir)
        except OmegaConfBaseException as error:
            raise ConfigError(f"hydra.run.dir cannot be resolved: {error}") from error
        if config.resume is None and "hydra.run.dir" not in map(key_of, given.hydra):
            folder = reserve(folder)
            composed.hydra.run.dir = str(folder)
    locks.enter_context(run_lock(folder))
    if config.resume is None and (folder / CONFIG).exists():
        raise ConfigError(f"{folder} already holds a run; continue it by resume={folder}")
    return config


def final_config(composed: DictConfig, overrides: Sequence[str]) -> Config:
    """Returns the checked configuration of a run; with ``resume``, that of the run's folder.

    Args:
        composed: the composed configuration.
        overrides: the overrides of the command line without Hydra's, which may change some keys
            of a resumed run.

    Raises:
        ConfigError: an invalid value or combination, or a run that cannot be resumed like this.
    """
    config = to_config(composed, Config)
    return config if config.resume is None else _resumed(config, overrides)


def _resumed(given: Config, overrides: Sequence[str]) -> Config:
    """Returns the configuration of the run to resume, with the changes of the command line."""
    folder = Path(to_absolute_path(os.path.expanduser(str(given.resume)))).resolve()
    run = run_config(folder)
    config = run_config(folder)
    config.resume = str(folder)
    for key in set(map(key_of, overrides)) - {"resume"}:
        changed = key if key in CHANGEABLE else key.partition(".")[0]
        if changed in CHANGEABLE:
            group, _, name = changed.rpartition(".")
            target, source = [getattr(one, group) if group else one for one in (config, given)]
            setattr(target, name, getattr(source, name))
        elif _value(given, key) != _value(run, key):
            raise ConfigError(
                f"{key} must be as in the run in {folder}, {shown(_value(run, key))}: with resume "
                f"only {', '.join(CHANGEABLE)} can be changed"
            )
    validate(config)
    rounds = config.protocol.rounds
    if rounds < run.protocol.rounds:
        raise ConfigError(
            f"protocol.rounds must be at least {run.protocol.rounds}, which {folder} was "
            f"started with, got {rounds}"
        )
    if is_finished(folder, rounds):
        raise ConfigError(
            f"the run in {folder} is finished ({rounds} rounds): protocol.rounds=<more> continues "
            "beyond the end of a run with protocol.keep_checkpoints=last"
        )
    return config


def _value(config: Any, key: str) -> Any:
    """Returns the value of a dotted key; for a group the name of its option."""
    for name in key.split("."):
        config = getattr(config, name, None)
    return getattr(config, "name", config)


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


def table_of_runs(sweep: Path) -> tuple[str, bool]:
    """Returns the table of a sweep's runs, and whether all of them are finished.

    A row has the folder, the overrides that not all runs share, the final success and the state.
    """
    folders = sorted((file.parent for file in sweep.rglob(HYDRA)), key=numbers_in_order)
    overrides = [_overrides(folder) for folder in folders]
    shared = set(overrides[0]).intersection(*overrides) if len(overrides) > 1 else set()
    rates = [_final_success(folder) for folder in folders]
    rows = [
        {
            "run": folder.relative_to(sweep),
            "overrides": " ".join(item for item in given if item not in shared),
            "final success": EMPTY if rate is None else f"{rate:.3f}",
            "state": f"not finished: {LOG} in it says why" if rate is None else "finished",
        }
        for folder, given, rate in zip(folders, overrides, rates, strict=True)
    ]
    finished = len(rates) - rates.count(None)
    title = f"{finished} of {len(rows)} runs in {sweep} are finished"
    return f"{title}\n\n{Table('runs', rows, words=4)}", finished == len(rows)


def _final_success(folder: Path) -> float | None:
    """Returns the final success of a finished run; None for others."""
    try:
        rounds = run_config(folder).protocol.rounds
    except ConfigError:
        return None
    result = finished_result(folder, rounds) if is_finished(folder, rounds) else None
    return None if result is None else result.success_rate


def _overrides(folder: Path) -> list[str]:
    """Returns the overrides in Hydra's file of a run; empty if it cannot be read."""
    try:
        noted: Any = read_yaml((folder / OVERRIDES).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [item for item in noted if isinstance(item, str)] if isinstance(noted, list) else []
