"""Trials: running one, its objective, and the table of all."""

from __future__ import annotations

import csv
import math
import shlex
from collections import Counter
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any

import optuna

from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.evaluation.run_result import read_result, write_json
from bbq_torchrl.runs.overrides import train_command
from bbq_torchrl.runs.resume import is_finished, restarted_config
from bbq_torchrl.trainers import TrainingError
from bbq_torchrl.utils.files import write_text
from bbq_torchrl.utils.statistics import interquartile_mean
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.evaluation.run_result import RunResult
    from bbq_torchrl.options import Config
    from bbq_torchrl.search.definition import Search, SearchConfig
    from bbq_torchrl.trainers import RoundTrainer
    from bbq_torchrl.trainers.recording import MetricRow

TRIALS = "trials.csv"
BEST = "best.json"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a trial.

    Attributes:
        state: complete, pruned or failed.
        value: the objective; ``None`` unless complete.
        reason: the reason for a failure.
    """

    state: optuna.trial.TrialState
    value: float | None = None
    reason: str | None = None


def play_trial(
    trial: optuna.Trial,
    config: Config,
    folder: Path,
    settings: SearchConfig,
    runner: Callable[..., RunResult],
    domain: Domain | None,
) -> Outcome:
    """Runs a trial: new, from its last checkpoint, or finished already.

    Args:
        trial: receives the reports of rounds, and decides on pruning.
        config: the configuration with the trial's values.
        folder: the trial's run folder.
        settings: the search's settings.
        runner: trains the trial.
        domain: the loaded domain.

    Raises:
        ConfigError: the folder has a run of another configuration.
    """
    states = optuna.trial.TrialState
    folder.mkdir(parents=True, exist_ok=True)
    config = restarted_config(config, folder, way="choose another search.folder")
    try:
        if is_finished(folder, config.protocol.rounds):
            result = read_result(folder)
        else:
            result = runner(config, folder, [_Reports(trial, settings)], domain=domain)
    except optuna.TrialPruned:
        return Outcome(states.PRUNED)
    except TrainingError as error:
        return Outcome(states.FAIL, reason=sentence(error))
    return Outcome(states.COMPLETE, _objective(result, folder, settings))


def _objective(result: RunResult, folder: Path, settings: SearchConfig) -> float:
    """Returns the objective: the replicas' mean or interquartile mean of success."""
    if settings.objective == "final":
        return _statistic([item.success_rate for item in result.per_replica], settings)
    values = [item.training_success for item in result.per_replica]
    if settings.objective == "early":
        success = read_metrics(folder)["success_rate"]
        first = success[: max(1, len(success) // 3)].mean(0)
        values = [(whole + float(early)) / 2 for whole, early in zip(values, first, strict=True)]
    return _statistic(values, settings)


def _statistic(values: Sequence[float], settings: SearchConfig) -> float:
    if settings.statistic == "iqm":
        return float(interquartile_mean(values))
    return math.fsum(values) / len(values)


class _Reports:
    """Reports the success of all dialogues so far after every round; prunes the trial."""

    def __init__(self, trial: optuna.Trial, settings: SearchConfig) -> None:
        self._trial = trial
        self._settings = settings
        # A resumed trial repeats rounds that it has already reported.
        known = trial.study.get_trials(deepcopy=False)[trial.number].intermediate_values
        self._reported = set(known)

    def __call__(self, trainer: RoundTrainer, rows: Sequence[MetricRow], /) -> None:
        replicas, done = len(rows), trainer.rounds_done
        success = [row["success_rate"] for row in trainer.metrics.rows]
        so_far = [math.fsum(success[replica::replicas]) / done for replica in range(replicas)]
        if done - 1 not in self._reported:
            self._trial.report(_statistic(so_far, self._settings), step=done - 1)
        if done < trainer.rounds and self._trial.should_prune():
            raise optuna.TrialPruned


def trial_name(number: int) -> str:
    """Returns the name of a trial's folder."""
    return f"trial_{number:04d}"


def best_trial(search: Search, study: optuna.Study) -> dict[str, Any] | None:
    """Returns the best complete trial and the command that repeats it; None without one."""
    trials = study.get_trials(deepcopy=False)
    complete = [item for item in trials if item.state is optuna.trial.TrialState.COMPLETE]
    if not complete:
        return None
    # The first of equal trials, however processes shared them.
    best = max(complete, key=lambda item: (item.value, -item.number))
    values = {name: best.params[name] for name in search.space}
    return {
        "trial": best.number,
        "value": best.value,
        "objective": search.settings.objective,
        "statistic": search.settings.statistic,
        "values": values,
        "folder": str(search.folder / trial_name(best.number)),
        "command": shlex.join([*train_command(), *search.overrides(values)]),
        "trials": dict(sorted(Counter(item.state.name.lower() for item in trials).items())),
    }


def write_tables(search: Search, study: optuna.Study) -> None:
    """Writes ``trials.csv`` and ``best.json`` atomically."""
    rows = [
        {
            "trial": item.number,
            "state": item.state.name.lower(),
            "value": "" if item.values is None else item.value,
            **{name: item.params.get(name, "") for name in search.space},
            "rounds": len(item.intermediate_values),
            "seconds": "" if item.duration is None else round(item.duration.total_seconds(), 1),
            "folder": trial_name(item.number),
            "reason": item.user_attrs.get("reason", ""),
        }
        for item in study.get_trials(deepcopy=False)
    ]
    text = StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    write_text(search.folder / TRIALS, text.getvalue())
    best = best_trial(search, study)
    if best is not None:
        write_json(best, search.folder / BEST)
