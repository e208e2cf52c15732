"""Groups of runs that differ only in the seed."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from bbq_torchrl.evaluation.curves import areas, booked, rounds_to_reach
from bbq_torchrl.evaluation.finished_runs import distinguishing_keys, names_option, read_run
from bbq_torchrl.evaluation.run_result import reference_lines
from bbq_torchrl.utils.reports import Report, Table
from bbq_torchrl.utils.text import as_typed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from bbq_torchrl.evaluation.finished_runs import Replica
    from bbq_torchrl.evaluation.run_result import RunResult

_OF_AN_AGENT = ("agent", "explore", "intrinsic")
"""Groups of options that define an agent."""


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
    def folders(self) -> list[Path]:
        """The result folders, each once."""
        return list(dict.fromkeys(replica.folder for replica in self.replicas))

    @property
    def agent(self) -> str:
        """The agent as the paper calls it, such as ``BBQN-MAP``."""
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
    def commit(self) -> str:
        """The commits of its runs, each once, as in :attr:`RunResult.code`."""
        return "; ".join(dict.fromkeys(replica.result.code for replica in self.replicas))

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


def read_groups(folders: Sequence[Path]) -> list[Group]:
    """Reads result folders. Returns a group for each setting, in the given order.

    Replicas of a run with different values have different settings.

    Raises:
        ValueError: two runs have the same setting and seed; also as :func:`read_run`.
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
    """Returns whether any of the runs has recorded its commit."""
    return any(replica.result.commit for group in groups for replica in group.replicas)


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
    scripted = [result.scripted for result in results.values()]
    known = _means(privileged)
    return reference_lines(
        _means(scripted),
        {name: rate for name, rate in known.items() if all(name in one for one in privileged)},
    )


def _means(rates: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Returns the mean of each name over the mappings that have it."""
    names = dict.fromkeys(name for one in rates for name in one)
    return {name: fmean(one[name] for one in rates if name in one) for name in names}


def label(
    name: str, setting: Mapping[str, Any], settings: Sequence[tuple[str, Mapping[str, Any]]]
) -> str:
    """Returns the agent's name, and the keys in which its setting differs from others.

    Keys that define an agent are named if agents of the same name differ in them, other keys also
    if any settings do. If options differ, the option is named instead of its keys. So no two
    settings have the same label.

    Args:
        name: the agent's name.
        setting: its dotted keys and values.
        settings: all names and settings, including this one.

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
    keys: set[str] = set()
    for other_name, other in settings:
        keys |= _distinguishing(setting, other, same_agent=other_name == name)
    options = sorted(filter(names_option, keys))
    words = [name, *(f"{key.removesuffix('.name')}={setting[key]}" for key in options)]
    words += [
        f"{key}={as_typed(value)}"
        for key, value in setting.items()
        if key in keys.difference(options)
    ]
    return ", ".join(words)


def _distinguishing(
    setting: Mapping[str, Any], other: Mapping[str, Any], *, same_agent: bool
) -> set[str]:
    """Returns the keys that distinguish a setting from another one."""
    if same_agent:
        # A key of null that the other one lacks is named only if nothing else differs.
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
    """Returns the commits of the runs, as text; empty if none is recorded."""
    if not know_commits(groups):
        return ""
    together: dict[str, list[str]] = {}
    for group in groups:
        together.setdefault(group.commit, []).append(group.label)
    if len(together) == 1:
        (commit,) = together
        if len({replica.result.code for replica in groups[0].replicas}) > 1:
            return f"All have runs of several commits: {commit}."
        return f"All runs are of commit {commit}."
    lines = [f"- {commit}: {'; '.join(labels)}" for commit, labels in together.items()]
    return "\n".join(["The runs are of different commits:\n", *lines])


def replicas_table(groups: Sequence[Group]) -> Table:
    """Returns the table of replicas."""
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
    """Returns a report on groups of runs, with their commits at the end and ``replicas.csv``."""
    return Report(name, title, [*parts, commits_text(groups)], figures, [replicas_table(groups)])
