"""Runs as groups: what differs only in its seed belongs together."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from bbq_torchrl.evaluation.metrics import areas, booked, rounds_to_reach
from bbq_torchrl.evaluation.results import reference_lines
from bbq_torchrl.evaluation.runs import distinguishing_keys, names_option, read_run
from bbq_torchrl.utils.reports import Report, Table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from bbq_torchrl.evaluation.results import RunResult
    from bbq_torchrl.evaluation.runs import Replica

_OF_AN_AGENT = ("agent", "explore", "intrinsic")
"""Groups that make up an agent: what is compared."""


@dataclass(frozen=True)
class Group:
    """Replicas of one setting, all their seeds together.

    Attributes:
        label: the agent, and what tells this group from others of the same agent.
        replicas: at least one.
    """

    label: str
    replicas: tuple[Replica, ...]

    @property
    def first(self) -> RunResult:
        """The result of one of the runs, for what they all have in common."""
        return self.replicas[0].result

    @property
    def folders(self) -> list[Path]:
        """The result folders, each once."""
        return list(dict.fromkeys(replica.folder for replica in self.replicas))

    @property
    def agent(self) -> str:
        """The agent as the paper calls it, such as ``BBQN-MAP``."""
        return self.replicas[0].agent

    @property
    def setting(self) -> dict[str, Any]:
        """Dotted key to value of all that decides the outcome, but for the seed."""
        return self.replicas[0].setting

    @property
    def final(self) -> list[float]:
        """Success rate of the final evaluation, one value for each seed."""
        return [replica.own.success_rate for replica in self.replicas]

    @property
    def cumulative(self) -> list[float]:
        """Share of all training dialogues that succeeded, one value for each seed."""
        return [replica.own.training_success for replica in self.replicas]

    def booked(self, first: int) -> list[float]:
        """Share of the first training dialogues that succeeded, one value for each seed.

        Empty where fewer were trained; see :func:`bbq_torchrl.evaluation.metrics.booked`.
        """
        return booked(self.success, self.round_dialogues, first)

    @property
    def reward(self) -> float:
        """Mean reward of a dialogue of the final evaluation, over all seeds."""
        return float(np.mean([replica.own.reward for replica in self.replicas]))

    @property
    def turns(self) -> float:
        """Mean number of agent turns of such a dialogue, over all seeds."""
        return float(np.mean([replica.own.turns for replica in self.replicas]))

    @property
    def members(self) -> list[tuple[int, int, str, int]]:
        """Identifies the random numbers that each seed trained with, in the order of the values."""
        return [replica.member for replica in self.replicas]

    @property
    def commit(self) -> str:
        """The commits of the code of its runs, each once, as :attr:`RunResult.code` has them."""
        return "; ".join(dict.fromkeys(replica.result.code for replica in self.replicas))

    @property
    def round_dialogues(self) -> int:
        """Training dialogues of a round and seed."""
        return int(self.replicas[0].metrics["dialogues"][0, 0])

    def curves(self, name: str) -> Any | None:
        """A column of the metrics, shape [rounds, seeds]; None where not all runs have it."""
        if any(name not in replica.metrics.columns for replica in self.replicas):
            return None
        columns = [replica.metrics[name][:, replica.number] for replica in self.replicas]
        return np.stack(columns, 1)

    @property
    def success(self) -> Any:
        """Success rate of the training dialogues of each round, shape [rounds, seeds]."""
        return self.curves("success_rate")

    @property
    def evaluation(self) -> Any | None:
        """Success rate of each round's evaluation, shape [rounds, seeds].

        NaN in rounds in which not all seeds were evaluated; None where there are no others.
        """
        curves = self.curves("eval_success_rate")
        if curves is None:
            return None
        is_evaluated = np.isfinite(curves).all(1, keepdims=True)
        return np.where(is_evaluated, curves, np.nan) if is_evaluated.any() else None

    @property
    def area(self) -> list[float]:
        """Area under the curve of these evaluations, one value for each seed; empty without."""
        return [] if self.evaluation is None else areas(self.evaluation)


def read_groups(folders: Sequence[Path]) -> list[Group]:
    """Reads result folders. Returns a group for each setting, in the order in which they come.

    Replicas of a run with different values are of different settings.

    Raises:
        ValueError: two runs are of the same setting and seed; and see :func:`read_run`.
    """
    return grouped(replica for folder in folders for replica in read_run(folder))


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
    settings = [(members[0].agent, members[0].setting) for members in together]
    return [
        Group(label(*own, settings), tuple(members))
        for own, members in zip(settings, together, strict=True)
    ]


def know_commits(groups: Sequence[Group]) -> bool:
    """Returns True if any of the runs knows the commit of its code."""
    return any(replica.result.commit for group in groups for replica in group.replicas)


def references(groups: Sequence[Group]) -> dict[str, float]:
    """Returns the policies that figures compare the groups with, as :func:`reference_lines` has it.

    Each rate is the mean over the runs that know it. Privileged policies are left out where a run
    does not know them, and all is where the users differ.
    """
    users = [
        {key: value for key, value in group.setting.items() if key.startswith(("env.", "domain."))}
        for group in groups
    ]
    if any(other != users[0] for other in users):
        return {}
    results = {replica.folder: replica.result for group in groups for replica in group.replicas}
    privileged = [result.references for result in results.values()]
    scripted = [result.scripted for result in results.values()]
    known = _means(privileged)
    return reference_lines(
        _means(scripted),
        {name: rate for name, rate in known.items() if all(name in one for one in privileged)},
    )


def _means(rates: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Returns each name's mean over those that have it."""
    names = dict.fromkeys(name for one in rates for name in one)
    return {name: fmean(one[name] for one in rates if name in one) for name in names}


def label(
    name: str, setting: Mapping[str, Any], settings: Sequence[tuple[str, Mapping[str, Any]]]
) -> str:
    """Returns the name, and the keys in which the setting differs from others.

    What makes up an agent is told where agents of the same name differ in it; all else also where
    agents of other names do. Of a group with several options the name is told, and other keys
    where settings of the same option differ in them. So no two settings have the same label.

    Args:
        name: of the agent.
        setting: its dotted keys and their values.
        settings: all names and settings, its own among them.

    Examples:
        >>> greedy = {"explore.name": "greedy"}
        >>> step = {"explore.name": "thompson", "explore.per": "step"}
        >>> whole = {"explore.name": "thompson", "explore.per": "round"}
        >>> settings = [("BBQN-MAP", one) for one in (greedy, step, whole)]
        >>> label("BBQN-MAP", greedy, settings)
        'BBQN-MAP, explore=greedy'
        >>> label("BBQN-MAP", step, settings)
        'BBQN-MAP, explore=thompson, explore.per=step'
    """
    told: set[str] = set()
    for other_name, other in settings:
        told |= _told_from(setting, other, same_agent=other_name == name)
    options = sorted(filter(names_option, told))
    words = [name, *(f"{key.removesuffix('.name')}={setting[key]}" for key in options)]
    words += [
        f"{key}={as_typed(value)}"
        for key, value in setting.items()
        if key in told.difference(options)
    ]
    return ", ".join(words)


def as_typed(value: Any) -> str:
    """Returns a value as it is written on a command line."""
    text = "null" if value is None else str(value)
    return text.lower() if isinstance(value, bool) else text


def _told_from(
    setting: Mapping[str, Any], other: Mapping[str, Any], *, same_agent: bool
) -> set[str]:
    """Returns the keys that tell a setting from another one."""
    if same_agent:
        # A key of null that the other one lacks is told where nothing else tells them apart.
        different = [key for key, value in setting.items() if other.get(key) != value]
        different = different or [key for key in setting if key not in other]
    else:
        different = [
            key
            for key, value in setting.items()
            if key.partition(".")[0] not in _OF_AN_AGENT and other.get(key, value) != value
        ]
    return set(distinguishing_keys(different))


def commits_text(groups: Sequence[Group]) -> str:
    """Returns of which commits the runs are; empty where no run knows."""
    if not know_commits(groups):
        return ""
    together: dict[str, list[str]] = {}
    for group in groups:
        together.setdefault(group.commit, []).append(group.label)
    if len({replica.result.code for group in groups for replica in group.replicas}) == 1:
        return f"All runs are of commit {groups[0].commit}."
    lines = [f"- {commit}: {'; '.join(labels)}" for commit, labels in together.items()]
    return "\n".join(["The runs are of different commits:\n", *lines])


def replicas_table(groups: Sequence[Group]) -> Table:
    """Returns a row for each replica."""
    rows = [
        {
            "corpus": replica.result.domain,
            "env": replica.result.env,
            "agent": group.label,
            "replica": replica.number,
            "seed": replica.result.seed,
            "rounds": replica.result.rounds,
            "updates": replica.updates,
            "success_rate": replica.own.success_rate,
            "reward": replica.own.reward,
            "turns": replica.own.turns,
            "cumulative_success": replica.own.training_success,
            "rounds_to_60": f"{reached:.0f}".replace("inf", ""),
        }
        | ({"commit": replica.result.code} if know_commits(groups) else {})
        for group in groups
        for replica, reached in zip(
            group.replicas, rounds_to_reach(group.success, 0.6).tolist(), strict=True
        )
    ]
    return Table("replicas", rows)


def runs_report(
    name: str,
    title: str,
    groups: Sequence[Group],
    parts: Sequence[str | Table],
    figures: Mapping[str, tuple[str, Callable[[], Figure]]],
) -> Report:
    """Returns a report on groups of runs: last their commits, and ``replicas.csv`` next to it."""
    return Report(name, title, [*parts, commits_text(groups)], figures, [replicas_table(groups)])
