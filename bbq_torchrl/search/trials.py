"""The search: trials in Optuna's database, shared by several processes, safe against kills.

A process that plays a trial tells the database that it lives (Optuna's heartbeat). A trial whose
process died is retried: it continues from its last checkpoint, in the same folder.
"""

from __future__ import annotations

import logging
import math
import shlex
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import optuna
from filelock import FileLock
from optuna.trial import FrozenTrial, TrialState
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.pool import NullPool

from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.evaluation.run_result import RunResult, read_result, write_json
from bbq_torchrl.options import Config
from bbq_torchrl.runs.compose import train_command
from bbq_torchrl.runs.folders import is_finished, refuse_links, restarted_config
from bbq_torchrl.search.definition import Search, SearchConfig
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import RoundTrainer, TrainingError
from bbq_torchrl.trainers.recording import MetricRow
from bbq_torchrl.trainers.round_trainer import RoundCallback
from bbq_torchrl.utils.output import sqlite_url
from bbq_torchrl.utils.reports import Table
from bbq_torchrl.utils.seeds import derive_seed
from bbq_torchrl.utils.statistics import interquartile_mean
from bbq_torchrl.utils.text import sentence

_LOG = logging.getLogger(__name__)

_HEARTBEAT, _GRACE = 20, 60  # seconds between signs of life, and until a trial counts as dead
_NUMBER, _REASON, _DEFINITION = "number", "reason", "definition"  # attributes of trials and study

with warnings.catch_warnings():
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    _RETRY = optuna.storages.RetryHeartbeatStaleTrialCallback(inherit_intermediate_values=True)


class _TrialFailed(Exception):
    """Ends a trial that cannot be trained; the search goes on."""


def run_search(
    search: Search,
    train: Callable[..., RunResult],
    check: Callable[[Config], object] = lambda config: None,
) -> dict[str, Any] | None:
    """Runs trials up to ``search.trials``. Returns the best; None if no trial is complete.

    An interrupted search continues: finished trials stay, and a killed trial resumes from its last
    checkpoint, a minute after its process died. At the end a process waits for the trials of
    others.

    Args:
        search: the search.
        train: trains a trial, as ``bbq_torchrl.runs.train.run`` does; called with configuration,
            folder and callbacks. An OSError, such as a full disk, ends the search, and
            the next start continues the trial; any other error fails the trial.
        check: further checks of a trial's configuration.

    Raises:
        ConfigError: the database has another search or cannot be used.
    """
    search.folder.mkdir(parents=True, exist_ok=True)
    refuse_links(search.folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        with FileLock(search.folder / ".search.lock"):  # a new database is made by one process
            study, storage = _open_study(search)
        try:
            _run_trials(search, study, train, check)
            return best_trial(search, study)
        finally:
            storage.remove_session()
            storage.engine.dispose()


def _run_trials(
    search: Search,
    study: optuna.Study,
    train: Callable[..., RunResult],
    check: Callable[[Config], object],
) -> None:
    """Plays trials until all have ended, also those of other processes."""

    def objective(trial: optuna.Trial) -> float:
        try:
            return _play(search, study, trial, train, check)
        except optuna.TrialPruned:
            raise
        except OSError:
            _RETRY(study, study.get_trials(deepcopy=False)[trial.number])
            raise
        except Exception as error:
            known = isinstance(error, (ValueError, TrainingError))
            reason = sentence(error) if known else f"{type(error).__name__}: {error}"
            trial.set_user_attr(_REASON, reason)
            raise _TrialFailed from error

    while True:
        while _to_start(search, study) > 0:
            study.optimize(objective, n_trials=1, catch=(_TrialFailed,))
            with FileLock(search.folder / ".search.lock"):
                write_tables(search, study)
        if not study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            break
        _LOG.info("waiting for the trials of other processes")
        time.sleep(_HEARTBEAT)
        optuna.storages.fail_stale_trials(study)


def _open_study(search: Search) -> tuple[optuna.Study, optuna.storages.RDBStorage]:
    """Opens the study, new or to continue, with the database that has it."""
    settings = search.settings
    url = settings.storage or sqlite_url(search.folder / "study.db")
    # Processes that share a file wait up to a minute for one another. A pool would leave
    # connections open if Optuna refuses the database.
    sqlite = {"connect_args": {"timeout": 60}, "poolclass": NullPool}
    pruner: optuna.pruners.BasePruner = optuna.pruners.NopPruner()
    if settings.pruner == "median":
        rounds = search.corners[0].protocol.rounds
        pruner = optuna.pruners.MedianPruner(
            n_startup_trials=settings.startup_trials,
            n_warmup_steps=int(settings.prune_after * rounds),
        )
    try:
        storage = optuna.storages.RDBStorage(
            url,
            engine_kwargs=sqlite if url.startswith("sqlite") else {},
            heartbeat_interval=_HEARTBEAT,
            grace_period=_GRACE,
            heartbeat_stale_trial_callback=_RETRY,
        )
        study = optuna.create_study(
            storage=storage,
            study_name=search.name,
            direction="maximize",
            load_if_exists=True,
            pruner=pruner,
        )
    # An invalid URL, a missing or invalid database, or a missing driver.
    except (SQLAlchemyError, optuna.exceptions.OptunaError, ImportError, RuntimeError) as error:
        raise ConfigError(f"search.storage={url} cannot be used: {sentence(error)}") from error
    definition = search.definition()
    if settings.storage is not None:
        definition["search.folder"] = str(search.folder)
    begun = study.user_attrs.get(_DEFINITION, definition)
    for key in {**begun, **definition}:
        if begun.get(key) != definition.get(key):
            storage.engine.dispose()
            raise ConfigError(
                f"{settings.storage or search.folder} has a search with {key}={begun.get(key)}, "
                f"got {definition.get(key)}: choose another search.folder or search.storage"
            )
    study.set_user_attr(_DEFINITION, definition)
    return study, storage


def _to_start(search: Search, study: optuna.Study) -> int:
    """Returns the number of trials still to start; a space of choices has one per combination."""
    trials = study.get_trials(deepcopy=False)
    choices = [entry.get("choices", ()) for entry in search.space.values()]
    most = math.prod(map(len, choices)) if all(choices) else math.inf
    under_way = sum(trial.state is TrialState.RUNNING for trial in trials)
    return int(min(search.settings.trials, most)) - len(_ended(study)) - under_way


def _ended(study: optuna.Study) -> list[FrozenTrial]:
    """Returns the trials that have an outcome; those of dead processes were queued again."""
    return [
        trial
        for trial in study.get_trials(deepcopy=False)
        if trial.state in (TrialState.COMPLETE, TrialState.PRUNED) or _REASON in trial.user_attrs
    ]


def _play(
    search: Search,
    study: optuna.Study,
    trial: optuna.Trial,
    train: Callable[..., RunResult],
    check: Callable[[Config], object],
) -> float:
    """Trains a trial: new, from its last checkpoint, or finished already. Returns its value."""
    known = study.get_trials(deepcopy=False)[: trial.number]
    new = sum(_RETRY.retried_trial_number(one) is None for one in known)
    number = trial.user_attrs.get(_NUMBER, new)
    trial.set_user_attr(_NUMBER, number)
    study.sampler = _sampler(search, derive_seed(search.settings.seed, "search", number) % 2**32)
    values = {}
    for key, entry in search.space.items():
        bounds = {name: value for name, value in entry.items() if name != "type"}
        values[key] = getattr(trial, f"suggest_{entry['type']}")(key, **bounds)
    _LOG.info("trial %d: %s", number, values)
    folder = search.folder / _folder_name(number)
    config = search.config(values)
    check(config)
    folder.mkdir(exist_ok=True)
    config = restarted_config(config, folder, way="choose another search.folder")
    if is_finished(folder, config.protocol.rounds):
        result = read_result(folder)
    else:
        result = train(config, folder, [_reports(trial, search.settings)])
    return _value(result, folder, search.settings)


def _sampler(search: Search, seed: int) -> optuna.samplers.BaseSampler:
    if all("choices" in entry for entry in search.space.values()):
        # TPE and random sampling would repeat the same few settings.
        return optuna.samplers.BruteForceSampler(seed=seed)
    if search.settings.sampler == "random":
        return optuna.samplers.RandomSampler(seed=seed)
    # constant_liar keeps processes from trying the same values at the same time.
    return optuna.samplers.TPESampler(
        n_startup_trials=search.settings.startup_trials, constant_liar=True, seed=seed
    )


def _reports(trial: optuna.Trial, settings: SearchConfig) -> RoundCallback:
    """Returns a callback that reports the success of all dialogues so far, and prunes the trial."""
    # A resumed trial repeats rounds that it has already reported.
    reported = {*trial.study.get_trials(deepcopy=False)[trial.number].intermediate_values}

    def report(trainer: RoundTrainer, rows: Sequence[MetricRow]) -> None:
        replicas, done = len(rows), trainer.rounds_done
        success = [row["success_rate"] for row in trainer.metrics.rows]
        so_far = [math.fsum(success[replica::replicas]) / done for replica in range(replicas)]
        if done - 1 not in reported:
            trial.report(_over_replicas(so_far, settings), step=done - 1)
        if done < trainer.rounds and trial.should_prune():
            raise optuna.TrialPruned

    return report


def _value(result: RunResult, folder: Path, settings: SearchConfig) -> float:
    """Returns the objective: the replicas' mean or interquartile mean of success."""
    if settings.objective == "final":
        return _over_replicas([item.success_rate for item in result.per_replica], settings)
    values = [item.training_success for item in result.per_replica]
    if settings.objective == "early":
        success = read_metrics(folder)["success_rate"]
        first = success[: max(1, len(success) // 3)].mean(0)
        values = [(whole + float(early)) / 2 for whole, early in zip(values, first, strict=True)]
    return _over_replicas(values, settings)


def _over_replicas(values: Sequence[float], settings: SearchConfig) -> float:
    if settings.statistic == "iqm":
        return float(interquartile_mean(values))
    return math.fsum(values) / len(values)


def _folder_name(number: int) -> str:
    return f"trial_{number:04d}"


def best_trial(search: Search, study: optuna.Study) -> dict[str, Any] | None:
    """Returns the best complete trial and the command that repeats it; None without one."""
    ended = _ended(study)
    complete = [trial for trial in ended if trial.state is TrialState.COMPLETE]
    if not complete:
        return None
    # The first of equal trials, however processes shared them.
    best = max(complete, key=lambda trial: (trial.value, -trial.user_attrs[_NUMBER]))
    values = {key: best.params[key] for key in search.space}
    return {
        "trial": best.user_attrs[_NUMBER],
        "value": best.value,
        "objective": search.settings.objective,
        "statistic": search.settings.statistic,
        "values": values,
        "folder": str(search.folder / _folder_name(best.user_attrs[_NUMBER])),
        "command": shlex.join([*train_command(), *search.overrides(values)]),
        "trials": dict(sorted(Counter(trial.state.name.lower() for trial in ended).items())),
    }


def write_tables(search: Search, study: optuna.Study) -> None:
    """Writes ``trials.csv``, a row for each trial that has ended, and ``best.json``."""
    rows = [
        {
            "trial": trial.user_attrs[_NUMBER],
            "state": trial.state.name.lower(),
            "value": None if trial.values is None else trial.value,
            **{key: trial.params.get(key, "") for key in search.space},
            "rounds": len(trial.intermediate_values),
            "seconds": trial.duration and round(trial.duration.total_seconds(), 1),
            "folder": _folder_name(trial.user_attrs[_NUMBER]),
            "reason": trial.user_attrs.get(_REASON, ""),
        }
        for trial in sorted(_ended(study), key=lambda trial: trial.user_attrs[_NUMBER])
    ]
    Table("trials", rows).write(search.folder)
    if (best := best_trial(search, study)) is not None:
        write_json(best, search.folder / "best.json")
