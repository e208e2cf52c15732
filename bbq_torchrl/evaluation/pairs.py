"""Paired comparison of groups: differences of replicas that trained with the same seed.

Replicas of the same number in two runs of the same seed see the same spiked dialogues and, in every
round, the same goals and simulator noise, as far as their settings agree. This shared luck cancels
out of their difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bbq_torchrl.evaluation.curves import areas
from bbq_torchrl.evaluation.finished_runs import distinguishing_keys
from bbq_torchrl.utils.statistics import PValue, estimate, holm, t_test

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.utils.statistics import Estimate

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
class Pairing:
    """One group minus another, over replicas of the same seed.

    Attributes:
        one: the minuend.
        other: the subtrahend.
        pairs: number of replicas with a partner in the other group.
        differences: ``final``, ``cumulative``, ``early`` (the first :data:`EARLY` training
            dialogues, if there are as many) and ``area`` (over the rounds in which both were
            evaluated during training): a value for each pair; empty without pairs.
        different: the keys in which the dialogues differ: ``spike.dialogues (20, 100)``.
    """

    one: Group
    other: Group
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
    return Pairing(one, other, len(shared), differences if shared else {}, different)


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
