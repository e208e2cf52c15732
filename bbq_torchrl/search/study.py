"""The search: trials in sequence, shared by several processes, safe against kills.

Optuna stores the trials in a database. A process locks a file for its trial, and the operating
system releases the lock when the process ends. So a running trial without a lock was killed, and
the first process that finds it continues it.
"""

from __future__ import annotations

import logging
import warnings
from contextlib import ExitStack, contextmanager
from math import prod
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import optuna
import yaml
from filelock import FileLock, Timeout
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.pool import NullPool

from bbq_torchrl.runs.folders import refuse_links
from bbq_torchrl.search.space import Choices, as_entry
from bbq_torchrl.search.trials import (
    Outcome,
    best_trial,
    play_trial,
    trial_name,
    write_tables,
)
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import TrainingError, derive_seed
from bbq_torchrl.utils.extras import sqlite_url
from bbq_torchrl.utils.files import CONFIG, read_yaml, write_text
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.evaluation.run_result import RunResult
    from bbq_torchrl.options import Config
    from bbq_torchrl.search.definition import Search

_LOG = logging.getLogger(__name__)
_DEFINITION = "search.yaml"
_DATABASE = "study.db"
_TIE = ".study"
_DEFINED, _TIED = "definition", "tie"


def run_search(
    search: Search,
    runner: Callable[..., RunResult],
    check: Callable[[Config], Domain | None] = lambda config: None,
) -> dict[str, Any] | None:
    """Runs trials up to ``search.trials``. Returns the best; None if no trial is complete.

    An interrupted search continues: finished trials stay, a killed trial resumes from its last
    checkpoint, and new trials get the same values as without the interruption.

    Args:
        search: the search.
        runner: trains a trial, as ``bbq_torchrl.runs.train.run`` does; called with configuration,
            folder, callbacks and ``domain=``. A TrainingError fails the trial; any other error ends
            the search, and the next start continues the trial.
        check: further checks of a trial's configuration; returns the loaded domain. A
            ``ConfigError``, for values that do not go together, fails the trial.

    Raises:
        ConfigError: the folder has another search, its trials and the storage do not belong
            together, or one of the two is unusable.
    """
    with _opened(search) as study:
        if (most := _most_trials(search)) < search.settings.trials:
            _LOG.info("search.trials=%d: the space has %d settings", search.settings.trials, most)
        _run_trials(search, study, runner, check)
        return best_trial(search, study)


def _run_trials(
    search: Search,
    study: optuna.Study,
    runner: Callable[..., RunResult],
    check: Callable[[Config], Domain | None],
) -> None:
    folder = search.folder
    while True:
        with _claimed(search, study, folder) as trial:
            if trial is None:
                break
            values = _values(search, study, trial)
            _LOG.info("trial %d: %s", trial.number, values)
            run_folder = folder / trial_name(trial.number)
            try:
                config = search.config(values)
                domain = check(config)
            except (ConfigError, TrainingError) as error:
                outcome = Outcome(optuna.trial.TrialState.FAIL, reason=sentence(error))
            else:
                outcome = play_trial(trial, config, run_folder, search.settings, runner, domain)
            # Locked, so that nobody takes the trial for an interrupted one.
            with FileLock(folder / ".search.lock"):
                _tell(study, trial, outcome)
        with FileLock(folder / ".tables.lock"):
            write_tables(search, study)


@contextmanager
def _opened(search: Search) -> Iterator[optuna.Study]:
    """Opens the study of a search, new or to continue, and closes its database at the end."""
    folder = search.folder
    with ExitStack() as opened:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            refuse_links(folder)
            with FileLock(folder / ".search.lock"):
                _check_definition(search, folder / _DEFINITION)
                study = _study(search, opened)
                _tie(study, folder, _database(search))
                if not (folder / _DEFINITION).exists():
                    text = yaml.safe_dump(search.definition(), sort_keys=False)
                    write_text(folder / _DEFINITION, text)
        except OSError as error:
            raise ConfigError(
                f"search.folder={folder} cannot be used: {sentence(error)}"
            ) from error
        yield study


def _check_definition(search: Search, file: Path) -> None:
    """Refuses a folder that was started with another definition."""
    if not file.exists():
        return
    try:
        begun = read_yaml(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{file} is damaged: {sentence(error)}") from error
    if not isinstance(begun, dict):
        raise ConfigError(f"{file} is damaged: it must be a mapping, got {shown(begun)}")
    _refuse_another(search, begun, f"{file.parent}", "search.folder")


def _refuse_another(search: Search, begun: Mapping[str, Any], place: str, choice: str) -> None:
    definition = search.definition()
    for key in {**begun, **definition}:
        if begun.get(key) != definition.get(key):
            raise ConfigError(
                f"{place} has a search with {key}={begun.get(key)}, got "
                f"{definition.get(key)}: choose another {choice}"
            )


def _tie(study: optuna.Study, folder: Path, database: str) -> None:
    """Ties a database to the folder of its trials by a mark in both.

    Raises:
        ConfigError: folder and database have different trials, so that values would be reported
            that were never trained there.
    """
    file = folder / _TIE
    of_folder = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else None
    of_study = study.user_attrs.get(_TIED)
    runs = any(folder.glob(f"trial_*/{CONFIG}"))
    if of_study is None and bool(study.get_trials(deepcopy=False)) == runs:
        # Both are new, or of a version without marks.
        of_study = of_folder = of_folder or uuid4().hex
        write_text(file, of_folder)
        study.set_user_attr(_TIED, of_study)
    if of_study is None or of_folder != of_study:
        fault = (
            f"{folder} has trials that {database} lacks"
            if of_study is None and runs
            else f"{database} has the search of another folder than {folder}"
        )
        raise ConfigError(f"{fault}: choose another search.folder")


def _database(search: Search) -> str:
    """Returns the name of a search's database for messages."""
    url = search.settings.storage
    return f"search.storage={url}" if url else str(search.folder / _DATABASE)


def _study(search: Search, opened: ExitStack) -> optuna.Study:
    settings = search.settings
    rounds = search.corners[0].protocol.rounds
    pruner: optuna.pruners.BasePruner = optuna.pruners.NopPruner()
    if settings.pruner == "median":
        pruner = optuna.pruners.MedianPruner(
            n_startup_trials=settings.startup_trials,
            n_warmup_steps=int(settings.prune_after * rounds),
        )
    url = settings.storage or sqlite_url(search.folder / _DATABASE)
    options: dict[str, Any] = {}
    if url.startswith("sqlite"):
        # Processes that share the file wait up to a minute for one another. A pool would leave
        # connections open if Optuna refuses the database.
        options = {"connect_args": {"timeout": 60}, "poolclass": NullPool}
    try:
        storage = optuna.storages.RDBStorage(url, engine_kwargs=options)
        opened.callback(storage.engine.dispose)
        opened.callback(storage.remove_session)
        study = optuna.create_study(
            storage=storage,
            study_name=search.name,
            direction="maximize",
            load_if_exists=True,
            pruner=pruner,
        )
    # An invalid URL, a missing or invalid database, or a missing driver.
    except (SQLAlchemyError, optuna.exceptions.OptunaError, ImportError, RuntimeError) as error:
        raise ConfigError(f"{_database(search)} cannot be used: {sentence(error)}") from error
    # The database may belong to a search in another folder.
    definition = search.definition()
    begun = study.user_attrs.get(_DEFINED, definition)
    _refuse_another(search, begun, "search.storage", "search.storage")
    study.set_user_attr(_DEFINED, definition)
    return study


@contextmanager
def _claimed(search: Search, study: optuna.Study, folder: Path) -> Iterator[optuna.Trial | None]:
    """Yields a locked trial, killed ones first; None if all are done."""
    trial, own = None, None
    with FileLock(folder / ".search.lock"):
        trials = study.get_trials(deepcopy=False)
        for known in trials:
            if known.state is optuna.trial.TrialState.RUNNING:
                lock = _trial_lock(folder, known.number)
                try:
                    lock.acquire(timeout=0)
                except Timeout:
                    continue
                # Optuna makes the object of a stored trial like this.
                trial, own = optuna.Trial(study, known._trial_id), lock
                _LOG.info("trial %d was interrupted and continues", known.number)
                break
        if trial is None and len(trials) < _most_trials(search):
            trial = study.ask()
            own = _trial_lock(folder, trial.number)
            own.acquire()
    try:
        yield trial
    finally:
        if own is not None:
            own.release()


def _trial_lock(folder: Path, number: int) -> FileLock:
    locks = folder / ".locks"
    locks.mkdir(exist_ok=True)
    return FileLock(locks / trial_name(number))


def _values(search: Search, study: optuna.Study, trial: optuna.Trial) -> dict[str, Any]:
    """Returns the trial's values, from separate seeds, so that interruptions change nothing."""
    values = {}
    for name, parameter in search.space.items():
        seed = derive_seed(search.settings.seed, "search", trial.number, name)
        study.sampler = _sampler(search, seed % 2**32)
        bounds = as_entry(parameter)
        # A trial that continues keeps its value.
        values[name] = getattr(trial, f"suggest_{bounds.pop('type')}")(name, **bounds)
    return values


def _has_choices_only(search: Search) -> bool:
    return all(isinstance(parameter, Choices) for parameter in search.space.values())


def _most_trials(search: Search) -> int:
    """Returns the number of trials; a space with only choices has one per combination."""
    if not _has_choices_only(search):
        return search.settings.trials
    return min(search.settings.trials, prod(len(item.probes) for item in search.space.values()))


def _sampler(search: Search, seed: int) -> optuna.samplers.BaseSampler:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        if _has_choices_only(search):
            # TPE and random sampling would repeat the same few settings.
            return optuna.samplers.BruteForceSampler(seed=seed)
        if search.settings.sampler == "random":
            return optuna.samplers.RandomSampler(seed=seed)
        # constant_liar keeps processes from trying the same values at the same time.
        return optuna.samplers.TPESampler(
            n_startup_trials=search.settings.startup_trials, constant_liar=True, seed=seed
        )


def _tell(study: optuna.Study, trial: optuna.Trial, outcome: Outcome) -> None:
    if outcome.reason is not None:
        trial.set_user_attr("reason", outcome.reason)
    # The brute-force sampler would stop Optuna's loop, which is not running here.
    study.sampler = optuna.samplers.RandomSampler()
    study.tell(trial, outcome.value, state=outcome.state)
    text = outcome.reason if outcome.value is None else f"{outcome.value:.4f}"
    _LOG.info(
        "trial %d is %s%s", trial.number, outcome.state.name.lower(), f": {text}" if text else ""
    )
