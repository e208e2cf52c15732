"""Runs as groups: what differs only in its seed belongs together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bbq_torchrl.evaluation.learning import areas
from bbq_torchrl.evaluation.runs import read_run, telling

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from bbq_torchrl.evaluation.results import RunResult
    from bbq_torchrl.evaluation.runs import Member, Run

__all__ = ["Group", "group_runs", "label", "read_groups"]

EVALUATION = "eval_success_rate"
"""Column of the metrics: success of an evaluation while training, empty in rounds without."""

_OF_AN_AGENT = ("agent", "explore", "intrinsic")
"""Groups that make up an agent: what is compared."""


@dataclass(frozen=True)
class Group:
    """Runs of one setting, all their seeds together.

    Attributes:
        label: the agent, and what tells this group from others of the same agent.
        runs: at least one.
    """

    label: str
    runs: tuple[Run, ...]

    @property
    def first(self) -> RunResult:
        """The result of one of the runs, for what they all have in common."""
        return self.runs[0].result

    @property
    def agent(self) -> str:
        """The agent as the paper calls it, such as ``BBQN-MAP``."""
        return self.runs[0].agent

    @property
    def setting(self) -> dict[str, Any]:
        """Dotted key to value of all that decides the outcome, but for the seed."""
        return self.runs[0].setting

    @cached_property
    def final(self) -> list[float]:
        """Success rate of the final evaluation, one value for each seed."""
        return self._per_seed("success_rate")

    @cached_property
    def cumulative(self) -> list[float]:
        """Share of all training dialogues that succeeded, one value for each seed."""
        return self._per_seed("training_success")

    @property
    def reward(self) -> float:
        """Mean reward of a dialogue of the final evaluation, over all seeds."""
        return float(np.mean(self._per_seed("reward")))

    @property
    def turns(self) -> float:
        """Mean number of agent turns of such a dialogue, over all seeds."""
        return float(np.mean(self._per_seed("turns")))

    @property
    def members(self) -> list[Member]:
        """A key for each seed, in the order of the values."""
        return [member for run in self.runs for member in run.members]

    @property
    def round_dialogues(self) -> int:
        """Training dialogues of a round and seed."""
        return int(self.runs[0].metrics["dialogues"][0, 0])

    @property
    def success(self) -> Any:
        """Success rate of the training dialogues of each round, shape [rounds, seeds]."""
        return self._curves("success_rate")

    @property
    def training_reward(self) -> Any | None:
        """Mean reward of each round's training dialogues, shape [rounds, seeds]; None without."""
        if any("reward" not in run.metrics.columns for run in self.runs):
            return None
        return self._curves("reward")

    @property
    def evaluation(self) -> Any | None:
        """Success rate of each round's evaluation, shape [rounds, seeds].

        NaN in rounds in which not all seeds were evaluated; None where there are no others.
        """
        if any(EVALUATION not in run.metrics.columns for run in self.runs):
            return None
        curves = self._curves(EVALUATION)
        is_evaluated = np.isfinite(curves).all(1, keepdims=True)
        return np.where(is_evaluated, curves, np.nan) if is_evaluated.any() else None

    @property
    def area(self) -> list[float]:
        """Area under the curve of these evaluations, one value for each seed; empty without."""
        return [] if self.evaluation is None else areas(self.evaluation)

    def _curves(self, name: str) -> Any:
        return np.concatenate([run.metrics[name] for run in self.runs], 1)

    def _per_seed(self, name: str) -> list[float]:
        return [
            float(getattr(entry, name)) for run in self.runs for entry in run.result.per_replica
        ]


def read_groups(folders: Sequence[Path]) -> list[Group]:
    """Reads result folders. Returns their runs as groups.

    Raises:
        ValueError: see :func:`read_run` and :func:`group_runs`.
    """
    return group_runs([read_run(folder) for folder in folders])


def group_runs(runs: Sequence[Run]) -> list[Group]:
    """Returns a group for each setting, in the order in which they come.

    Replicas of a run that have values of their own are of different settings.

    Raises:
        ValueError: two runs are of the same setting and seed.
    """
    together: list[tuple[dict[str, Any], list[Run]]] = []
    for run in (part for whole in runs for part in whole.by_values()):
        setting = run.setting
        same = next((runs for known, runs in together if known == setting), None)
        if same is None:
            together.append((setting, [run]))
            continue
        for other in same:
            if other.result.seed == run.result.seed:
                raise ValueError(
                    f"{other.folder} and {run.folder} are of the same setting and seed "
                    f"({run.result.seed}): seeds must differ to count as independent trainings"
                )
        same.append(run)
    settings = [(runs[0].agent, setting) for setting, runs in together]
    return [
        Group(label(name, setting, settings), tuple(runs))
        for (name, setting), (_, runs) in zip(settings, together, strict=True)
    ]


def references(groups: Sequence[Group]) -> dict[str, float]:
    """Returns the success of the privileged policies, by name, mean over the runs.

    Empty unless the runs all know it and have the same users.
    """
    runs = [run for group in groups for run in group.runs]
    users = [
        {key: value for key, value in run.setting.items() if key.startswith(("env.", "domain."))}
        for run in runs
    ]
    known = [run.result.references for run in runs]
    if any(other != users[0] for other in users) or any(
        one.keys() != known[0].keys() for one in known
    ):
        return {}
    return {name: math.fsum(one[name] for one in known) / len(known) for name in known[0]}


def label(
    name: str, setting: Mapping[str, Any], settings: Sequence[tuple[str, Mapping[str, Any]]]
) -> str:
    """Returns the name, and the keys in which the setting differs from others.

    What makes up an agent is told where agents of the same name differ in it; all else also where
    agents of other names do.

    Args:
        name: of the agent.
        setting: its dotted keys and their values.
        settings: all names and settings, its own among them.
    """
    keys = [
        key
        for key, value in setting.items()
        if any(
            other.get(key) != value
            if other_name == name
            else key.partition(".")[0] not in _OF_AN_AGENT and other.get(key, value) != value
            for other_name, other in settings
        )
    ]
    # The options first, by group.
    told = sorted(telling(keys), key=lambda key: (0, key) if key.endswith(".name") else (1, ""))
    return ", ".join([name, *(f"{key.removesuffix('.name')}={setting[key]}" for key in told)])
