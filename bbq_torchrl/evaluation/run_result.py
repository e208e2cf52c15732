"""result.json: the final evaluation of a run, and the evaluations during its training."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from statistics import fmean
from typing import Any, TypeVar

from bbq_torchrl.domains.domain import RANDOM_POLICY
from bbq_torchrl.utils.files import RESULT, write_text
from bbq_torchrl.utils.statistics import binomial_standard_error
from bbq_torchrl.utils.text import sentence, shown

LAST = 5
"""Number of evaluations averaged in ``last_five``."""


@dataclass(frozen=True)
class TrainingEvaluation:
    """Success rates of the evaluations during training.

    Attributes:
        last: the last one.
        last_five: mean of the last five, or of all if fewer.
        best: the best one; as the maximum of noisy rates it is biased upwards.
        best_round: the round of the best one, from 0. With domain extension a best from before the
            domain grew counts only until the next evaluation.
    """

    last: float
    last_five: float
    best: float
    best_round: float


@dataclass(frozen=True)
class ReplicaResult:
    """The final evaluation of one trained replica.

    Attributes:
        replica: the replica's number.
        success_rate: share of successful dialogues.
        standard_error: of that rate, over dialogues (binomial).
        reward: mean sum of rewards of a dialogue.
        turns: mean number of agent turns of a dialogue.
        dialogues: number of dialogues evaluated.
        training_success: share of all training dialogues that succeeded (cumulative success).
        values: dotted key -> the replica's value, for keys with a list.
        while_training: the evaluations during training; None without any.
    """

    replica: int
    success_rate: float
    standard_error: float
    reward: float
    turns: float
    dialogues: int
    training_success: float
    values: dict[str, float] = field(default_factory=dict)
    while_training: TrainingEvaluation | None = None


@dataclass(frozen=True)
class RunResult:
    """The content of result.json.

    Attributes:
        agent: the option, such as ``bbqn``; likewise ``explore``, ``env``.
        domain: the domain's name.
        policy: the evaluated policy: ``mean``, ``average``, ``draw``, ``thompson``, ``greedy`` or
            ``vote``.
        seed: the run's seed.
        rounds: rounds trained.
        replicas: number of independent seeds trained in parallel.
        success_rate: mean over replicas, whatever their values; likewise reward, turns,
            training_success.
        standard_error: of success_rate over the dialogues of *these* replicas (binomial). For the
            spread over seeds see :mod:`bbq_torchrl.evaluation.compare_runs`.
        dialogues: number of dialogues evaluated.
        per_replica: an entry for each replica.
        wall_seconds: time of training and evaluation, without that of killed processes.
        versions: package -> version, for the packages that affect the numbers.
        intrinsic: the option.
        while_training: the evaluations during training, means over the replicas (also of
            ``best_round``); None without any.
        scripted: scripted policy -> success rate in the environment of the final evaluation.
        references: the same for privileged policies, which read what no agent observes.
        skipped: a sentence for each part of the corpus left out.
        commit: hash of the code's commit, the last one for a resumed training; None outside a
            checkout.
        clean: whether the code was as committed; None if unknown.
        warnings: a sentence for each replica whose mean Q was outside the range of returns.
        diverged: replicas whose loss became NaN or infinite, which the means leave out.
    """

    agent: str
    explore: str
    env: str
    domain: str
    policy: str
    seed: int
    rounds: int
    replicas: int
    success_rate: float
    standard_error: float
    reward: float
    turns: float
    dialogues: int
    training_success: float
    per_replica: tuple[ReplicaResult, ...]
    wall_seconds: float
    versions: dict[str, str]
    intrinsic: str = "none"
    while_training: TrainingEvaluation | None = None
    scripted: dict[str, float] = field(default_factory=dict)
    references: dict[str, float] = field(default_factory=dict)
    skipped: tuple[str, ...] = ()
    commit: str | None = None
    clean: bool | None = None
    warnings: tuple[str, ...] = ()
    diverged: tuple[int, ...] = ()

    @property
    def code(self) -> str:
        """The abbreviated commit: ``c33954a``, ``c33954a (changed)``, or ``unknown``."""
        if self.commit is None:
            return "unknown"
        return self.commit[:7] + (" (changed)" if self.clean is False else "")

    @classmethod
    def of(cls, per_replica: Sequence[ReplicaResult], **described: Any) -> RunResult:
        """Returns the result of replicas evaluated on equally many dialogues."""
        return cls(**_summed(per_replica, described.get("diverged", ())), **described)

    def only(self, replicas: Sequence[int]) -> RunResult:
        """Returns the result of some of the replicas."""
        return replace(self, **_summed([self.per_replica[replica] for replica in replicas]))


def _summed(per_replica: Sequence[ReplicaResult], diverged: Sequence[int] = ()) -> dict[str, Any]:
    """Returns the fields of a result that aggregate its replicas."""
    counted = [item for item in per_replica if item.replica not in diverged]
    errors = [item.standard_error for item in counted]
    means = ("success_rate", "reward", "turns", "training_success")
    return {
        "replicas": len(per_replica),
        "standard_error": math.sqrt(math.fsum(error**2 for error in errors)) / len(errors),
        "dialogues": sum(item.dialogues for item in counted),
        "per_replica": tuple(per_replica),
        "while_training": _mean_evaluation([item.while_training for item in counted]),
    } | {name: fmean(getattr(item, name) for item in counted) for name in means}


Result = TypeVar("Result", TrainingEvaluation, ReplicaResult, RunResult)


def replica_result(
    replica: int,
    success: Sequence[float],
    reward: Sequence[float],
    turns: Sequence[float],
    training_success: float,
    values: Mapping[str, float] | None = None,
    while_training: TrainingEvaluation | None = None,
) -> ReplicaResult:
    """Summarizes the dialogues of a replica; each sequence has an entry per dialogue."""
    dialogues = len(success)
    rate = fmean(success)
    return ReplicaResult(
        replica=replica,
        success_rate=rate,
        standard_error=binomial_standard_error(rate, dialogues),
        reward=fmean(reward),
        turns=fmean(turns),
        dialogues=dialogues,
        training_success=training_success,
        values=dict(values or {}),
        while_training=while_training,
    )


def training_evaluation(
    rates: Sequence[float], best: float, best_round: int
) -> TrainingEvaluation | None:
    """Summarizes the evaluations of a replica during training; None without any.

    Args:
        rates: success rate by round; NaN in rounds without an evaluation.
        best: success rate of the best weights.
        best_round: their round.
    """
    found = [float(rate) for rate in rates if not math.isnan(rate)]
    if not found:
        return None
    return TrainingEvaluation(found[-1], fmean(found[-LAST:]), best, best_round)


def _mean_evaluation(
    of_replicas: Sequence[TrainingEvaluation | None],
) -> TrainingEvaluation | None:
    """Returns the mean of every field; None if a replica has no evaluation."""
    found = [asdict(item) for item in of_replicas if item is not None]
    if len(found) < len(of_replicas):
        return None
    return TrainingEvaluation(**{name: fmean(item[name] for item in found) for name in found[0]})


def flat_numbers(result: RunResult) -> dict[str, float]:
    """Returns the numbers of a result by name, for a logger.

    Names are ``success_rate``, ``success_rate/replica_0``, ``while_training/best``,
    ``scripted/rule`` and so on; seed, rounds and replicas, which the configuration has, are left
    out.
    """
    plain = asdict(result)
    of_replicas = plain.pop("per_replica")
    for key in ("seed", "rounds", "replicas"):
        del plain[key]
    numbers = flat(plain, "/")
    for item in of_replicas:
        end = f"/replica_{item.pop('replica')}"
        numbers |= {f"{name}{end}": value for name, value in flat(item, "/").items()}
    return {name: value for name, value in numbers.items() if isinstance(value, (int, float))}


def flat(plain: Mapping[str, Any], joint: str = ".", prefix: str = "") -> dict[str, Any]:
    """Returns the values of nested mappings by their keys, joined: ``agent.lr``."""
    leaves: dict[str, Any] = {}
    for name, value in plain.items():
        key = f"{prefix}{name}"
        leaves |= flat(value, joint, f"{key}{joint}") if isinstance(value, dict) else {key: value}
    return leaves


def reference_lines(
    scripted: Mapping[str, float], privileged: Mapping[str, float]
) -> dict[str, float]:
    """Returns label -> success rate of the lines that figures compare agents with.

    Args:
        scripted: scripted policy -> success rate; the best one becomes a line.
        privileged: privileged policy -> success rate.

    Examples:
        >>> reference_lines({"rule": 0.2, "repair": 0.8, "random": 0.0}, {})
        {'repair (best script measured)': 0.8}
    """
    lines = {
        f"{name} (privileged: it reads what no agent is shown)": rate
        for name, rate in privileged.items()
    }
    if (best := best_script(scripted)) is not None:
        lines[f"{best} (best script measured)"] = scripted[best]
    return lines


def best_script(scripted: Mapping[str, float]) -> str | None:
    """Returns the scripted policy with the highest success rate, except the random one."""
    names = [name for name in scripted if name != RANDOM_POLICY]
    return max(names, key=scripted.__getitem__, default=None)


def write_json(content: RunResult | dict[str, Any], file: Path) -> None:
    """Writes JSON atomically."""
    plain = asdict(content) if isinstance(content, RunResult) else content
    write_text(file, json.dumps(plain, indent=2) + "\n")


def read_result(folder: Path) -> RunResult:
    """Reads the result.json of a run folder.

    Raises:
        ValueError: the file is missing (the run is not finished) or damaged.
    """
    file = folder / RESULT
    if not file.is_file():
        raise ValueError(f"{folder} has no {RESULT}: it is not a run folder, or not finished")
    try:
        return result_of(json.loads(file.read_text(encoding="utf-8-sig")))
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise ValueError(f"{file} is damaged: {sentence(error)}") from error


def result_of(plain: Mapping[str, Any]) -> RunResult:
    """Returns the result of a result.json's content.

    Raises:
        ValueError: a number is missing or not finite, or a replica is missing.
    """
    replicas = tuple(_made(ReplicaResult, item) for item in plain["per_replica"])
    if len(replicas) != plain["replicas"]:
        raise ValueError("per_replica must have an entry for each of the replicas")
    return _made(
        RunResult,
        {
            **plain,
            "per_replica": replicas,
            "skipped": (*plain["skipped"],),
            "warnings": (*plain.get("warnings", ()),),
            "diverged": (*plain.get("diverged", ()),),
        },
    )


def _made(schema: type[Result], plain: Mapping[str, Any]) -> Result:
    """Makes a dataclass from a mapping."""
    evaluated = plain.get("while_training")
    if evaluated is not None:
        plain = {**plain, "while_training": _made(TrainingEvaluation, evaluated)}
    result = schema(**plain)
    for item in fields(result):
        value = getattr(result, item.name)
        is_number = isinstance(value, (int, float)) and math.isfinite(value)
        if item.type in ("int", "float") and not is_number:
            raise ValueError(f"{item.name} must be a number, got {shown(value)}")
    return result
