"""Groups compared by pairs: replicas that trained on the same dialogues, one minus the other.

A replica of one agent and the replica of the same number in another agent's run of the same seed
see the same spiked dialogues and, in every round, the same goals and the same noise of the
simulator. So the luck that both share cancels out of their difference.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bbq_torchrl.evaluation.learning import areas
from bbq_torchrl.evaluation.runs import telling
from bbq_torchrl.evaluation.statistics import estimate, t_test
from bbq_torchrl.study.statistics import holm

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.evaluation.statistics import Estimate

__all__ = [
    "NOT_RUN",
    "Comparison",
    "Pairing",
    "compare",
    "pair",
    "pairings",
    "verdict",
]

ALPHA = 0.05
NOT_RUN = "not run"

_OF_DIALOGUES = (
    "env.",
    "domain.",
    "spike.dialogues",
    "spike.policy",
    "protocol.rounds",
    "protocol.dialogues",
)
"""How keys begin that decide which dialogues are seen."""

NO_PARTNER = (
    "no replica has a partner (one of the same number in a run of the same seed, number of "
    "replicas and device)"
)
"""The remark where all else fits."""


@dataclass(frozen=True)
class Pairing:
    """One group minus another, over replicas that trained on the same dialogues.

    Attributes:
        one: the one group.
        other: the group that is subtracted.
        pairs: how many replicas of the one have a partner in the other.
        differences: of ``final_success``, ``training_success`` and, over the rounds in which both
            were evaluated while training, ``evaluation_area``; empty if there are no pairs.
        p_values: of the same quantities, by a t test of the differences.
        remark: why there are no pairs, or how many replicas have no partner; empty if all have one.
    """

    one: Group
    other: Group
    pairs: int = 0
    differences: Mapping[str, Estimate] = field(default_factory=dict)
    p_values: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""

    @property
    def label(self) -> str:
        """Such as ``BBQN-MAP minus DQN``."""
        return f"{self.one.label} minus {self.other.label}"


def pairings(groups: Sequence[Group]) -> list[Pairing]:
    """Compares each group with each that comes after it."""
    return [pair(one, other) for number, one in enumerate(groups) for other in groups[number + 1 :]]


def pair(one: Group, other: Group, *, same_dialogues: bool = True) -> Pairing:
    """Compares two groups by pairs.

    Args:
        one: the one group.
        other: the group that is subtracted.
        same_dialogues: if False, replicas of one seed are partners even where the setting changes
            the dialogues themselves. The t test holds for any pairs that were fixed beforehand;
            but less luck is shared, so that it cancels out less.
    """
    if same_dialogues and (different := _different_dialogues(one, other)):
        return Pairing(one, other, remark=", ".join(different))
    shared = sorted({*one.members} & {*other.members})
    pairs = len(shared)
    if pairs == 0:
        return Pairing(one, other, remark=NO_PARTNER)
    places = [(one.members.index(member), other.members.index(member)) for member in shared]
    differences = {
        name: [minuend[mine] - subtrahend[theirs] for mine, theirs in places]
        for name, (minuend, subtrahend) in _compared(one, other).items()
    }
    alone = [
        f"{len(group.members) - pairs} of {len(group.members)} replicas of {group.label}"
        for group in (one, other)
        if len(group.members) > pairs
    ]
    return Pairing(
        one,
        other,
        pairs,
        {name: estimate(values) for name, values in differences.items()},
        {name: t_test(values) for name, values in differences.items()},
        " and ".join(alone),
    )


def _different_dialogues(one: Group, other: Group) -> list[str]:
    """Returns in which keys the dialogues of two groups differ: ``env.name differs (a, b)``.

    A key that one of them lacks, being of another version, is not compared.
    """
    settings = [group.runs[0].setting for group in (one, other)]
    different = {
        key: (value, settings[1][key])
        for key, value in settings[0].items()
        if key.startswith(_OF_DIALOGUES) and settings[1].get(key, value) != value
    }
    return [f"{key} differs ({', '.join(map(str, different[key]))})" for key in telling(different)]


def _compared(one: Group, other: Group) -> dict[str, tuple[Sequence[float], Sequence[float]]]:
    """Returns each quantity of both groups, a value for each seed."""
    quantities: dict[str, tuple[Sequence[float], Sequence[float]]] = {
        "final_success": (one.final, other.final),
        "training_success": (one.cumulative, other.cumulative),
    }
    first, second = one.evaluation, other.evaluation
    if first is not None and second is not None:
        in_both = np.isfinite(first[:, :1]) & np.isfinite(second[:, :1])
        if in_both.any():
            quantities["evaluation_area"] = (
                areas(np.where(in_both, first, np.nan)),
                areas(np.where(in_both, second, np.nan)),
            )
    return quantities


class Comparison(NamedTuple):
    """One of some groups minus another one, as declared before anything was run.

    Attributes:
        one: the name of the one.
        other: the name of the one that is subtracted.
        difference: its mean over pairs with the t interval; None if it was not run.
        p_value: by a t test of the differences, adjusted by Holm's method; 1 if it was not run.
    """

    one: str
    other: str
    difference: Estimate | None
    p_value: float

    def cells(self) -> tuple[str, str, str]:
        """Returns difference, p-value and verdict as they stand in a table."""
        if self.difference is None:
            return "–", "–", NOT_RUN
        p_value = f"{self.p_value:.3f}" if self.p_value >= 0.001 else "< .001"
        return f"{self.difference:+.3f}", p_value, verdict(self.difference, self.p_value)


def compare(
    groups: Mapping[str, Group],
    declared: Sequence[tuple[str, str]],
    quantity: str,
    *,
    same_dialogues: bool = True,
) -> list[Comparison]:
    """Compares what was declared by ``final_success`` or the like, what was not run included.

    ``same_dialogues`` is that of :func:`pair`.
    """
    found = [
        pair(groups[one], groups[other], same_dialogues=same_dialogues)
        if {one, other} <= groups.keys()
        else None
        for one, other in declared
    ]
    compared = [item if item is not None and item.pairs > 1 else None for item in found]
    adjusted = holm([1.0 if item is None else item.p_values[quantity] for item in compared])
    return [
        Comparison(*names, None if item is None else item.differences[quantity], p_value)
        for names, item, p_value in zip(declared, compared, adjusted, strict=True)
    ]


def verdict(difference: Estimate, p_value: float) -> str:
    """Returns what a difference says of the claim that it is above 0.

    ``yes``, ``no`` (it is below 0) or ``not decided``.
    """
    if p_value >= ALPHA:
        return "not decided"
    return "yes" if difference.value > 0 else "no"
