"""result.json: how a run's final evaluation, and those while it was trained, went."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, fields, replace
from statistics import fmean
from typing import TYPE_CHECKING, Any, TypeVar

from bbq_torchrl.domains.parts import RANDOM_POLICY
from bbq_torchrl.utils.files import RESULT, write_text
from bbq_torchrl.utils.statistics import binomial_standard_error
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

LAST = 5
"""Evaluations while training that ``last_five`` is the mean of."""


@dataclass(frozen=True)
class TrainingEvaluation:
    """The evaluations while training, as success rates.

    Attributes:
        last: of the last of them.
        last_five: mean of the last five, or of as many as there are.
        best: of the best one: the largest of many noisy rates, so rather too high.
        best_round: the round at whose end that was, from 0. With domain extension a best from
            before the domain grew counts only until the next evaluation.
    """

    last: float
    last_five: float
    best: float
    best_round: float


@dataclass(frozen=True)
class ReplicaResult:
    """The final evaluation of one trained replica.

    Attributes:
        replica: its number.
        success_rate: of the final evaluation's dialogues.
        standard_error: of that rate, over dialogues (binomial).
        reward: mean sum of rewards of a dialogue.
        turns: mean number of agent turns of a dialogue.
        dialogues: number of dialogues evaluated.
        training_success: share of all training dialogues that succeeded (cumulative success).
        values: dotted key to value, of the keys that have a list with a value for each replica.
        while_training: of the evaluations while training; None where there were none.
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
        agent: option of the group, such as ``bbqn``; likewise ``explore``, ``env``.
        domain: the domain's own name.
        policy: how the agent acted when evaluated: ``mean``, ``average``, ``draw``, ``thompson``,
            ``greedy`` or ``vote``.
        seed: of the run.
        rounds: rounds trained.
        replicas: independent seeds trained side by side.
        success_rate: mean over replicas, whatever their values; likewise reward, turns,
            training_success.
        standard_error: of success_rate over the dialogues of *these* replicas (binomial). It does
            not tell how another seed would do: see :mod:`bbq_torchrl.evaluation.report`.
        dialogues: evaluated in all.
        per_replica: one entry for each replica.
        wall_seconds: of training and evaluation together, without the time of killed processes.
        versions: of the packages that decide the numbers.
        intrinsic: option of the group; ``none`` in results of versions without it.
        while_training: of the evaluations while training: means over the replicas, of the round of
            the best too; None where there were none.
        scripted: success rates of the scripted policies in the environment of the final
            evaluation, by name; empty in results of versions without it.
        references: the same of the privileged policies, which read what no agent is shown.
        skipped: what of the corpus was left out, a sentence each.
        commit: of the code, as a hash; None where it ran outside of a checkout, and in results of
            versions without it. Of a training that was resumed, the last one.
        clean: whether the code was as in the commit; None where that is not known.
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

    @property
    def code(self) -> str:
        """The commit in short: ``c33954a``, ``c33954a (changed)``, or ``unknown``."""
        if self.commit is None:
            return "unknown"
        return self.commit[:7] + (" (changed)" if self.clean is False else "")

    @classmethod
    def of(cls, per_replica: Sequence[ReplicaResult], **described: Any) -> RunResult:
        """The result of replicas that were evaluated on equally many dialogues."""
        return cls(**_summed(per_replica), **described)

    def only(self, replicas: Sequence[int]) -> RunResult:
        """The result of some of the replicas."""
        return replace(self, **_summed([self.per_replica[replica] for replica in replicas]))


def _summed(per_replica: Sequence[ReplicaResult]) -> dict[str, Any]:
    """Returns what a result holds of its replicas together."""
    errors = [item.standard_error for item in per_replica]
    means = ("success_rate", "reward", "turns", "training_success")
    return {
        "replicas": len(per_replica),
        "standard_error": math.sqrt(math.fsum(error**2 for error in errors)) / len(errors),
        "dialogues": sum(item.dialogues for item in per_replica),
        "per_replica": tuple(per_replica),
        "while_training": _mean_evaluation([item.while_training for item in per_replica]),
    } | {name: fmean(getattr(item, name) for item in per_replica) for name in means}


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
    """Sums up the dialogues of one replica: one entry of each sequence for each dialogue."""
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
    """Sums up the evaluations of one replica; None if there are none.

    Args:
        rates: success rate by round; NaN where a round had no evaluation.
        best: of the best weights that were kept.
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

    Such as ``success_rate``, ``success_rate/replica_0``, ``while_training/best`` and
    ``scripted/rule``; seed, rounds and replicas are the configuration's.
    """
    plain = asdict(result)
    of_replicas = plain.pop("per_replica")
    for key in ("seed", "rounds", "replicas"):
        del plain[key]
    numbers = dict(_leaves(plain))
    for item in of_replicas:
        replica = item.pop("replica")
        numbers |= {f"{name}/replica_{replica}": value for name, value in _leaves(item)}
    return numbers


def _leaves(plain: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    for name, value in plain.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{name}/")
        elif isinstance(value, (int, float)):
            yield f"{prefix}{name}", value


def reference_lines(
    scripted: Mapping[str, float], privileged: Mapping[str, float]
) -> dict[str, float]:
    """Returns the lines that figures compare agents with: label to success rate.

    Args:
        scripted: success rates of scripted policies by name; the best of them is the line to beat.
        privileged: those of the policies that read what no agent is shown.

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
    """Returns the scripted policy with the highest success rate, but for the random one."""
    names = [name for name in scripted if name != RANDOM_POLICY]
    return max(names, key=scripted.__getitem__, default=None)


def write_json(content: RunResult | dict[str, Any], file: Path) -> None:
    """Writes JSON, atomically, so that a reader never sees half of it."""
    plain = asdict(content) if isinstance(content, RunResult) else content
    write_text(file, json.dumps(plain, indent=2) + "\n")


def read_result(folder: Path) -> RunResult:
    """Reads the result.json of a result folder.

    Raises:
        ValueError: there is none (the run is not finished), or it is damaged.
    """
    file = folder / RESULT
    if not file.is_file():
        raise ValueError(f"{folder} has no {RESULT}: it is no run folder, or not finished")
    try:
        plain = json.loads(file.read_text(encoding="utf-8-sig"))
        if not isinstance(plain, dict) or not isinstance(plain.get("per_replica"), list):
            raise ValueError("it must be a mapping with the list per_replica")
        of_replicas = tuple(_made(ReplicaResult, item) for item in plain["per_replica"])
        if len(of_replicas) != plain.get("replicas"):
            raise ValueError("per_replica must have an entry for each of the replicas")
        skipped = tuple(plain.get("skipped", ()))
        return _made(RunResult, plain | {"per_replica": of_replicas, "skipped": skipped})
    except RecursionError:
        raise ValueError(f"{file} is damaged: it is nested too deeply") from None
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{file} is damaged: {error}") from error


def _made(schema: type[Result], plain: dict[str, Any]) -> Result:
    """Returns what a mapping describes; a newer version's further keys are left out.

    Raises:
        ValueError: what should be a number, a text or a mapping is none.
    """
    names = {item.name for item in fields(schema)}
    given = {name: value for name, value in plain.items() if name in names}
    if given.get("while_training") is not None:
        given["while_training"] = _made(TrainingEvaluation, given["while_training"])
    result = schema(**given)
    for item in fields(result):
        value = getattr(result, item.name)
        if item.type in ("int", "float") and not (
            isinstance(value, (int, float)) and math.isfinite(value)
        ):
            raise ValueError(f"{item.name} must be a number, got {shown(value)}")
        if item.type == "str" and not isinstance(value, str):
            raise ValueError(f"{item.name} must be a text, got {shown(value)}")
        if item.type == "str | None" and not isinstance(value, (str, type(None))):
            raise ValueError(f"{item.name} must be a text or null, got {shown(value)}")
        if item.type == "bool | None" and not isinstance(value, (bool, type(None))):
            raise ValueError(f"{item.name} must be true, false or null, got {shown(value)}")
        if item.type == "dict[str, float]" and not (
            isinstance(value, dict)
            and all(isinstance(rate, (int, float)) for rate in value.values())
        ):
            raise ValueError(f"{item.name} must be a mapping to numbers, got {shown(value)}")
    return result
