"""Paired comparison of groups: differences of replicas that trained on the same dialogues.

Replicas of the same number in two runs of the same seed see the same spiked dialogues and, in every
round, the same goals and simulator noise. This shared luck cancels out of their difference.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bbq_torchrl.evaluation.curves import areas
from bbq_torchrl.evaluation.finished_runs import distinguishing_keys
from bbq_torchrl.utils.reports import NONE
from bbq_torchrl.utils.statistics import ALPHA, PValue, estimate, holm, t_test

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.evaluation.groups import Group
    from bbq_torchrl.utils.statistics import Estimate

EARLY = 1_000
"""First training dialogues that count as early success."""

NOT_RUN = "not run"
NOT_PAIRED = "not paired"
"""Verdict on two groups that were run but have fewer than two pairs."""

_OF_DIALOGUES = (
    "env.",
    "domain.",
    "spike.dialogues",
    "spike.policy",
    "protocol.rounds",
    "protocol.dialogues",
)
"""Prefixes of the keys that determine the dialogues."""

_PUBLIC = ("movie", "miulab", "hotel", "restaurant")
_FOUND_SCRIPT = {"rule": "rule", "best": "repair"}
"""``spike`` -> the script that ``spike.policy=null`` finds in the public domains."""

NO_PARTNER = (
    "no replica has a partner (one of the same number in a run of the same seed, number of "
    "replicas and device)"
)
"""The remark on groups with equal settings of the dialogues but no pairs."""


@dataclass(frozen=True)
class Pairing:
    """One group minus another, over replicas that trained on the same dialogues.

    Attributes:
        one: the minuend.
        other: the subtrahend.
        pairs: number of replicas with a partner in the other group.
        differences: ``final``, ``cumulative``, ``early`` (the first :data:`EARLY` training
            dialogues, if there are as many) and ``area`` (over the rounds in which both were
            evaluated during training): a value for each pair; empty without pairs.
        remark: why there are no pairs, or the number of replicas without a partner; else empty.
    """

    one: Group
    other: Group
    pairs: int = 0
    differences: Mapping[str, Sequence[float]] = field(default_factory=dict)
    remark: str = ""

    @property
    def label(self) -> str:
        """Such as ``BBQN-MAP minus DQN``."""
        return f"{self.one.label} minus {self.other.label}"


def pair(one: Group, other: Group, *, same_dialogues: bool = True) -> Pairing:
    """Compares two groups by pairs.

    Args:
        one: the minuend.
        other: the subtrahend.
        same_dialogues: if False, replicas of one seed are partners even if their settings of the
            dialogues differ. The t test is valid for any pairs fixed beforehand, but less shared
            luck cancels out.
    """
    if same_dialogues and (different := _different_dialogues(one, other)):
        return Pairing(one, other, remark=", ".join(different))
    shared = sorted({*one.members} & {*other.members})
    pairs = len(shared)
    if pairs == 0:
        return Pairing(one, other, remark=NO_PARTNER)
    places = [(one.members.index(member), other.members.index(member)) for member in shared]
    differences = {
        quantity: [minuend[mine] - subtrahend[theirs] for mine, theirs in places]
        for quantity, (minuend, subtrahend) in _compared(one, other).items()
    }
    alone = [
        f"{len(group.members) - pairs} of {len(group.members)} replicas of {group.label}"
        for group in (one, other)
        if len(group.members) > pairs
    ]
    return Pairing(one, other, pairs, differences, " and ".join(alone))


def _different_dialogues(one: Group, other: Group) -> list[str]:
    """Returns the keys in which the dialogues of two groups differ: ``env.name differs (a, b)``.

    A key that one of them lacks, as in another version, is not compared.
    """
    ours, theirs = (_with_script(group.setting) for group in (one, other))
    different = {
        key: (value, theirs[key])
        for key, value in ours.items()
        if key.startswith(_OF_DIALOGUES) and theirs.get(key, value) != value
    }
    return [
        f"{key} differs ({', '.join(map(str, different[key]))})"
        for key in distinguishing_keys(different)
    ]


def _with_script(setting: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a setting with the script that spikes named, where the run found it by itself."""
    if "spike.policy" not in setting or setting["spike.policy"] is not None:
        return {**setting}
    spike = str(setting.get("spike.name"))
    found = _FOUND_SCRIPT.get(spike) if setting.get("domain.name") in _PUBLIC else spike
    return {**setting, "spike.policy": found}


def _compared(one: Group, other: Group) -> dict[str, tuple[list[float], list[float]]]:
    """Returns each quantity of both groups, a value per seed."""
    quantities = {"final": (one.final, other.final)}
    quantities["cumulative"] = (one.cumulative, other.cumulative)
    early = one.booked(EARLY), other.booked(EARLY)
    if all(early):
        quantities["early"] = early
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


class Comparison(NamedTuple):
    """A comparison of two groups that was declared before the runs.

    Attributes:
        one: the name of the minuend.
        other: the name of the subtrahend.
        differences: a value per pair; None if one of the two was not run.
        p_value: of a t test of the differences, adjusted by Holm's method; 1 below two pairs.
    """

    one: str
    other: str
    differences: Sequence[float] | None
    p_value: float

    @property
    def label(self) -> str:
        """Such as ``BBQN-MAP minus DQN``."""
        return f"{self.one} minus {self.other}"

    def cells(self) -> tuple[object, object, str]:
        """Returns the cells of a table: mean difference with t interval, p-value, verdict.

        The verdict on a difference above 0 is ``yes``, ``no`` (it is below), ``not significant``,
        ``not paired`` or ``not run``.
        """
        if self.differences is None:
            return NONE, NONE, NOT_RUN
        if len(self.differences) < 2:
            return NONE, NONE, NOT_PAIRED
        mean = difference(self.differences)
        verdict = "yes" if mean.value > 0 else "no"
        return mean, PValue(self.p_value), verdict if self.p_value < ALPHA else "not significant"


def compare(
    groups: Mapping[str, Group],
    declared: Sequence[tuple[str, str]],
    quantity: str,
    *,
    same_dialogues: bool = True,
) -> list[Comparison]:
    """Returns the declared comparisons by one quantity, including those that were not run.

    The quantity is a name in :attr:`Pairing.differences`, such as ``final``; ``same_dialogues`` is
    passed to :func:`pair`.
    """
    found: list[Sequence[float] | None] = []
    for one, other in declared:
        values = None
        if {one, other} <= groups.keys():
            paired = pair(groups[one], groups[other], same_dialogues=same_dialogues)
            values = paired.differences.get(quantity, ())
        found.append(values)
    adjusted = holm([t_test(values or ()) for values in found])
    return [
        Comparison(*names, values, p_value)
        for names, values, p_value in zip(declared, found, adjusted, strict=True)
    ]
