"""One trial: a run with a trial's values, what is reported while it runs, and what it is worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import optuna

from bbq_torchrl.cli.parameters import Choices, IntegerRange
from bbq_torchrl.cli.resume import is_finished
from bbq_torchrl.evaluation.results import read_result
from bbq_torchrl.evaluation.statistics import interquartile_mean
from bbq_torchrl.run_folder import CONFIG
from bbq_torchrl.text import sentence
from bbq_torchrl.trainers import TrainingError

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.cli.parameters import Parameter
    from bbq_torchrl.cli.searches import SearchConfig
    from bbq_torchrl.evaluation.results import RunResult
    from bbq_torchrl.options import Config
    from bbq_torchrl.trainers import RoundTrainer
    from bbq_torchrl.trainers.metrics import MetricRow

__all__ = ["Outcome", "Runner", "play_trial", "suggest"]

Runner = Callable[["Config", "Path", "Sequence[Any]"], "RunResult"]
"""Trains a configuration in a folder, with callbacks for rounds: ``bbq_torchrl.run.run``."""


@dataclass(frozen=True)
class Outcome:
    """How a trial ended.

    Attributes:
        state: complete, pruned or failed.
        value: the objective; ``None`` unless complete.
        reason: why it failed.
    """

    state: optuna.trial.TrialState
    value: float | None = None
    reason: str | None = None


def suggest(trial: optuna.Trial, name: str, parameter: Parameter) -> Any:
    """Returns the trial's value for a key; a trial that goes on gets the value it has."""
    if isinstance(parameter, Choices):
        return trial.suggest_categorical(name, parameter.choices)
    bounds = {key: value for key, value in asdict(parameter).items() if value is not None}
    if isinstance(parameter, IntegerRange):
        return trial.suggest_int(name, **bounds)
    return trial.suggest_float(name, **bounds)


def play_trial(
    trial: optuna.Trial,
    config: Config,
    folder: Path,
    settings: SearchConfig,
    runner: Runner,
) -> Outcome:
    """Runs a trial from where it is: new, from its last checkpoint, or finished already.

    Args:
        trial: takes the reports of rounds, and says when it is hopeless.
        config: the configuration with the trial's values.
        folder: the trial's run folder.
        settings: of the search.
        runner: see :data:`Runner`.
    """
    states = optuna.trial.TrialState
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / CONFIG).is_file():
        config = replace(config, resume=str(folder))
    try:
        if is_finished(folder, config.protocol.rounds):
            result = read_result(folder)
        else:
            result = runner(config, folder, [_Reports(trial, settings)])
    except optuna.TrialPruned:
        return Outcome(states.PRUNED)
    except TrainingError as error:
        return Outcome(states.FAIL, reason=sentence(error))
    return Outcome(states.COMPLETE, _worth(result, settings))


def _worth(result: RunResult, settings: SearchConfig) -> float:
    """The objective: the replicas' mean or interquartile mean of the success that counts."""
    final = settings.objective == "final"
    return _sum_up(
        [item.success_rate if final else item.training_success for item in result.per_replica],
        settings,
    )


def _sum_up(values: Sequence[float], settings: SearchConfig) -> float:
    if settings.statistic == "iqm":
        return float(interquartile_mean(values))
    return math.fsum(values) / len(values)


class _Reports:
    """Reports the success of all dialogues so far after every round; ends a hopeless trial."""

    def __init__(self, trial: optuna.Trial, settings: SearchConfig) -> None:
        self._trial = trial
        self._settings = settings
        # A trial that goes on from a checkpoint plays rounds again that it has reported already.
        known = trial.study.get_trials(deepcopy=False)[trial.number].intermediate_values
        self._reported = set(known)

    def __call__(self, trainer: RoundTrainer, rows: Sequence[MetricRow], /) -> None:
        replicas, done = len(rows), trainer.rounds_done
        success = [row["success_rate"] for row in trainer.metrics.rows]
        so_far = [math.fsum(success[replica::replicas]) / done for replica in range(replicas)]
        if done - 1 not in self._reported:
            self._trial.report(_sum_up(so_far, self._settings), step=done - 1)
        if done < trainer.settings.rounds and self._trial.should_prune():
            raise optuna.TrialPruned
