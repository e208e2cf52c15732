"""Groups of runs that differ only in the seed, and their differences by pairs.

Replicas of the same number in two runs of the same seed see the same spiked dialogues and, in every
round, the same goals and simulator noise, as far as their settings agree. This shared luck cancels
out of their difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from bbq_torchrl.evaluation.curves import Reach, areas, booked, rounds_to_reach
from bbq_torchrl.evaluation.finished_runs import (
    Replica,
    distinguishing_keys,
    names_option,
    read_runs,
)
from bbq_torchrl.evaluation.run_result import RunResult, reference_lines
from bbq_torchrl.utils.statistics import Estimate, PValue, estimate, holm, t_test
from bbq_torchrl.utils.text import as_typed

_OF_AN_AGENT = ("agent.", "explore.", "intrinsic.")
"""Prefixes of the keys that define an agent."""


EARLY = 1_000
"""First training dialogues that count as early success."""

_OF_DIALOGUES = (
    "env.",
    "domain.",
    "spike.dialogues",
    "spike.policy",
    "protocol.rounds",
    "protocol.dialogues",
)
"""Prefixes of the keys that determine the dialogues."""


@dataclass(frozen=True)
class Group:
    """Replicas of one setting, all their seeds together.

    Attributes:
        label: the agent, and the keys that distinguish the group.
        replicas: at least one replica.
    """

    label: str
    replicas: tuple[Replica, ...]

    @property
    def first(self) -> RunResult:
        """The result of the first run, for the values that all runs share."""
        return self.replicas[0].result

    @property
    def agent(self) -> str:
        """The name of agent and exploration, such as ``BBQN-MAP``."""
        return self.replicas[0].agent

    @property
    def setting(self) -> dict[str, Any]:
        """Dotted key -> value of everything but the seed that affects the outcome."""
        return self.replicas[0].setting

    @property
    def final(self) -> list[float]:
        """Success rate of the final evaluation, per seed."""
        return [replica.own.success_rate for replica in self.replicas]

    @property
    def cumulative(self) -> list[float]:
        """Share of all training dialogues that succeeded, per seed."""
        return [replica.own.training_success for replica in self.replicas]

    def booked(self, first: int) -> list[float]:
        """Share of the first training dialogues that succeeded, per seed.

        Empty if fewer were trained; see :func:`bbq_torchrl.evaluation.curves.booked`.
        """
        return booked(self.success, self.round_dialogues, first)

    @property
    def reward(self) -> float:
        """Mean reward of the final evaluation's dialogues, over all seeds."""
        return float(np.mean([replica.own.reward for replica in self.replicas]))

    @property
    def turns(self) -> float:
        """Mean number of agent turns of the final evaluation's dialogues, over all seeds."""
        return float(np.mean([replica.own.turns for replica in self.replicas]))

    @property
    def members(self) -> list[tuple[int, int, str, int]]:
        """Identifiers of the random numbers of each seed, in the order of the values."""
        return [replica.member for replica in self.replicas]

    @property
    def round_dialogues(self) -> int:
        """Training dialogues per round and seed."""
        return int(self.replicas[0].metrics["dialogues"][0, 0])

    def curves(self, name: str) -> Any | None:
        """Returns a column of the metrics, shape [rounds, seeds]; None if a run lacks it."""
        if any(name not in replica.metrics.columns for replica in self.replicas):
            return None
        columns = [replica.metrics[name][:, replica.number] for replica in self.replicas]
        return np.stack(columns, 1)

    @property
    def dialogues(self) -> int:
        """Training dialogues of each seed."""
        return self.round_dialogues * self.first.rounds

    def reach(self, level: float) -> Reach:
        """Returns the training dialogues that the seeds took to reach a success rate."""
        reached = rounds_to_reach(self.success, level) * self.round_dialogues
        return Reach(tuple(reached.tolist()), self.dialogues)

    @property
    def success(self) -> Any:
        """Success rate of the training dialogues of each round, shape [rounds, seeds]."""
        return self.curves("success_rate")

    @property
    def evaluation(self) -> Any | None:
        """Success rate of each round's evaluation, shape [rounds, seeds].

        NaN in rounds in which not all seeds were evaluated; None if all rounds are such.
        """
        curves = self.curves("eval_success_rate")
        if curves is None:
            return None
        is_evaluated = np.isfinite(curves).all(1, keepdims=True)
        return np.where(is_evaluated, curves, np.nan) if is_evaluated.any() else None

    @property
    def area(self) -> list[float]:
        """Area under the curve of these evaluations, per seed; empty without evaluations."""
        return [] if self.evaluation is None else areas(self.evaluation)


def read_groups(folders: Iterable[Path]) -> list[Group]:
    """Reads run folders and tables of experiments. Returns a group for each setting, in order.

    Replicas of a run with different values have different settings.

    Raises:
        ValueError: two runs have the same setting and seed; also as :func:`read_runs`.
    """
    return grouped(replica for folder in folders for replica in read_runs(folder))


def grouped(replicas: Iterable[Replica]) -> list[Group]:
    """Returns a group for each setting, as :func:`read_groups` does."""
    together: list[list[Replica]] = []
    for replica in replicas:
        same = next((one for one in together if one[0].setting == replica.setting), None)
        if same is None:
            together.append([replica])
            continue
        for other in same:
            if other.result.seed == replica.result.seed and other.folder != replica.folder:
                raise ValueError(
                    f"{other.folder} and {replica.folder} are of the same setting and seed "
                    f"({replica.result.seed}): seeds must differ to count as independent trainings"
                )
        same.append(replica)
    return labeled(Group("", tuple(members)) for members in together)


def labeled(groups: Iterable[Group]) -> list[Group]:
    """Returns the groups with labels: the agent, and the keys in which it differs from the first.

    Keys that define an agent are named if it differs in them from the first one of its name. If
    options differ, the option is named instead of its keys, unless another group has that label.
    """
    found: dict[str, Group] = {}
    firsts: dict[str, Group] = {}
    for group in groups:
        first = next(iter(found.values()), group)
        own = firsts.setdefault(group.agent, group)
        keys = [key for key in _different(group, first) if not key.startswith(_OF_AN_AGENT)]
        keys += _different(group, own)
        while (label := _label(group, keys)) in found:
            keys += _different(group, found[label], with_options=True)
        found[label] = replace(group, label=label)
    return [*found.values()]


def _different(one: Group, other: Group, *, with_options: bool = False) -> list[str]:
    """Returns the keys in which two settings differ; of other options only their name."""
    ours, theirs = one.setting, other.setting
    keys = [key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key)]
    return keys if with_options else distinguishing_keys(keys)


def _label(group: Group, keys: Iterable[str]) -> str:
    words = [
        f"{key.removesuffix('.name')}={as_typed(group.setting.get(key))}"
        for key in sorted({*keys}, key=lambda key: (not names_option(key), key))
    ]
    return ", ".join([group.agent, *words])


def references(groups: Sequence[Group]) -> dict[str, float]:
    """Returns label -> success rate of the policies that figures compare the groups with.

    Each rate is the mean over the runs that have it. Privileged policies that a run lacks are left
    out. Groups with different users have no references.
    """
    users = [
        {key: value for key, value in group.setting.items() if key.startswith(("env.", "domain."))}
        for group in groups
    ]
    if any(other != users[0] for other in users):
        return {}
    results = {replica.folder: replica.result for group in groups for replica in group.replicas}
    privileged = [result.references for result in results.values()]
    known = _means(privileged)
    return reference_lines(
        _means([result.scripted for result in results.values()]),
        {name: rate for name, rate in known.items() if all(name in one for one in privileged)},
    )


def _means(rates: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Returns the mean of each name over the mappings that have it."""
    names = dict.fromkeys(name for one in rates for name in one)
    return {name: fmean(one[name] for one in rates if name in one) for name in names}


@dataclass(frozen=True)
class Pairing:
    """One group minus another, over replicas of the same seed.

    Attributes:
        pairs: number of replicas with a partner in the other group.
        differences: ``final``, ``cumulative``, ``early`` (the first :data:`EARLY` training
            dialogues, if there are as many) and ``area`` (over the rounds in which both were
            evaluated during training): a value for each pair; empty without pairs.
        different: the keys in which the dialogues differ: ``spike.dialogues (20, 100)``.
    """

    pairs: int
    differences: Mapping[str, Sequence[float]]
    different: Sequence[str]


def pair(one: Group, other: Group) -> Pairing:
    """Compares two groups by pairs: members of one seed, number of replicas and type of device."""
    shared = sorted({*one.members} & {*other.members})
    places = [(one.members.index(member), other.members.index(member)) for member in shared]
    differences = {
        quantity: [minuend[mine] - subtrahend[theirs] for mine, theirs in places]
        for quantity, (minuend, subtrahend) in _compared(one, other).items()
    }
    ours, theirs = one.setting, other.setting
    keys = [
        key
        for key, value in ours.items()
        if key.startswith(_OF_DIALOGUES) and theirs.get(key, value) != value
    ]
    different = [f"{key} ({ours[key]}, {theirs[key]})" for key in distinguishing_keys(keys)]
    return Pairing(len(shared), differences if shared else {}, different)


def _compared(one: Group, other: Group) -> dict[str, tuple[list[float], list[float]]]:
    """Returns each quantity of both groups, a value per seed."""
    quantities = {"final": (one.final, other.final)}
    early = one.booked(EARLY), other.booked(EARLY)
    if all(early):
        quantities["early"] = early
    quantities["cumulative"] = (one.cumulative, other.cumulative)
    first, second = one.evaluation, other.evaluation
    if first is not None and second is not None and len(first) == len(second):
        in_both = np.isfinite(first[:, :1]) & np.isfinite(second[:, :1])
        if in_both.any():
            own, theirs = (areas(np.where(in_both, of, np.nan)) for of in (first, second))
            quantities["area"] = (own, theirs)
    return quantities


def difference(values: Sequence[float]) -> Estimate:
    """Returns the mean of differences of rates with its t interval, printed with signs."""
    return estimate(values, "+.3f", bounds=(-1.0, 1.0))


def adjusted(compared: Sequence[Sequence[float]]) -> list[PValue]:
    """Returns p-values of t tests of the differences, adjusted together by Holm's method.

    Args:
        compared: the differences of each comparison; fewer than two give 1.
    """
    return [PValue(value) for value in holm([t_test(values) for values in compared])]
