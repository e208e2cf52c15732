"""Finished runs as groups: what differs only in its seed belongs together."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

from bbq_torchrl.evaluation.names import agent_name
from bbq_torchrl.evaluation.results import (
    RESULT_FILE,
    Metrics,
    RunResult,
    read_metrics,
    read_result,
)
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

__all__ = ["Group", "Member", "Run", "find_results", "read_groups", "read_run"]

CONFIG_FILE = "config.yaml"

EVALUATION = "eval_success_rate"
"""Column of the metrics: success of an evaluation while training, empty in rounds without."""

_OF_A_SEED = ("seed", "replicas", "resume", "device", "threads", "logger")
"""Keys in which runs of one setting may differ, whole groups too."""

_OF_A_MACHINE = (
    "protocol.checkpoint_every",
    "protocol.keep_checkpoints",
    "protocol.eval_batch",
    # Evaluating while training leaves no trace in what is trained.
    "protocol.eval_every",
    "protocol.eval_every_dialogues",
)

_NAMED = ("agent", "explore")
"""Groups that every configuration of a run has, each with the name of its option."""

_OF_AN_AGENT = ("agent", "explore", "intrinsic")
"""Groups that make up an agent: what is compared."""


class Member(NamedTuple):
    """Which random numbers a replica has trained with: members that are equal, with the same ones.

    Attributes:
        seed: of its run.
        replicas: of its run: random numbers are drawn for all of them together.
        device: type of its run's device, such as ``cpu``.
        replica: its number.
    """

    seed: int
    replicas: int
    device: str
    replica: int


@dataclass(frozen=True)
class Run:
    """A finished run as its result folder tells it, or those of its replicas with one value.

    Attributes:
        folder: the result folder.
        config: the composed configuration, nested mappings; a key with a list, a value for each
            replica, has the one value of these replicas (see :meth:`by_values`).
        result: of the final evaluation.
        metrics: of the training.
    """

    folder: Path
    config: Mapping[str, Any]
    result: RunResult
    metrics: Metrics

    @property
    def setting(self) -> dict[str, Any]:
        """Dotted key to value of all that decides the outcome, but for the seed."""
        flat = {
            key: value
            for key, value in _flat(self.config)
            if key.partition(".")[0] not in _OF_A_SEED and key not in _OF_A_MACHINE
        }
        return flat | {"protocol.rounds": self.result.rounds}

    @property
    def members(self) -> list[Member]:
        """A key for each replica, in order."""
        replicas = int(self.config.get("replicas", self.result.replicas))
        device = str(self.config.get("device", "cpu")).partition(":")[0]
        return [
            Member(self.result.seed, replicas, device, entry.replica)
            for entry in self.result.per_replica
        ]

    def by_values(self) -> list[Run]:
        """The replicas that have the same values, where keys have a list; else the run itself."""
        together: dict[tuple[tuple[str, float], ...], list[int]] = {}
        for number, entry in enumerate(self.result.per_replica):
            together.setdefault(tuple(entry.values.items()), []).append(number)
        return [
            replace(
                self,
                config=_with_values(self.config, dict(values)),
                result=self.result.only(replicas),
                metrics=self.metrics.only(replicas),
            )
            if values
            else self
            for values, replicas in together.items()
        ]

    @property
    def updates(self) -> list[float]:
        """Steps of the optimizer of each replica; NaN in metrics of versions that lack them."""
        if "updates" not in self.metrics.columns:
            return [math.nan] * self.metrics.replicas
        return [int(count) for count in self.metrics["updates"].sum(0)]

    @property
    def agent(self) -> str:
        """The agent as the paper calls it, such as ``BBQN-MAP``."""
        return agent_name(self.config)


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

    def _curves(self, name: str) -> Any:
        return np.concatenate([run.metrics[name] for run in self.runs], 1)

    def _per_seed(self, name: str) -> list[float]:
        return [
            float(getattr(entry, name)) for run in self.runs for entry in run.result.per_replica
        ]


def find_results(places: Iterable[Path]) -> list[Path]:
    """Returns the result folders that are, or lie anywhere below, the given folders.

    Raises:
        ValueError: there is none in one of them.
    """
    found: dict[Path, None] = {}
    for place in places:
        if (place / RESULT_FILE).is_file():
            folders = [place]
        else:
            folders = sorted(file.parent for file in place.rglob(RESULT_FILE))
        if not folders:
            raise ValueError(f"{place} holds no finished run: no {RESULT_FILE} is in or below it")
        found.update(dict.fromkeys(folder.resolve() for folder in folders))
    return list(found)


def read_run(folder: Path) -> Run:
    """Reads a result folder.

    Raises:
        ValueError: a file is missing or damaged, or the files are not of the same run.
    """
    result, metrics = read_result(folder), read_metrics(folder)
    if (metrics.rounds, metrics.replicas) != (result.rounds, result.replicas):
        raise ValueError(
            f"{folder}: the metrics are of {metrics.rounds} rounds and {metrics.replicas} "
            f"replicas, the result of {result.rounds} and {result.replicas}"
        )
    try:
        config = yaml.safe_load((folder / CONFIG_FILE).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        deep = isinstance(error, RecursionError)
        reason = "it is nested too deeply" if deep else sentence(error)
        raise ValueError(f"{folder / CONFIG_FILE} cannot be read: {reason}") from error
    groups = [config.get(name) for name in _NAMED] if isinstance(config, dict) else [None]
    if not all(isinstance(group, dict) and "name" in group for group in groups):
        raise ValueError(f"{folder / CONFIG_FILE} is not the configuration of a run")
    return Run(folder, config, result, metrics)


def read_groups(folders: Sequence[Path]) -> list[Group]:
    """Reads result folders. Returns a group for each setting, in the order in which they come.

    Replicas of a run that have values of their own are of different settings.

    Raises:
        ValueError: see :func:`read_run`; or two runs are of the same setting and seed.
    """
    together: list[tuple[dict[str, Any], list[Run]]] = []
    for run in (part for folder in folders for part in read_run(folder).by_values()):
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
    names = [runs[0].agent for _, runs in together]
    settings = [setting for setting, _ in together]
    settings_of: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for name, setting in zip(names, settings, strict=True):
        settings_of[name].append(setting)
    return [
        Group(_label(name, setting, settings_of[name], settings), tuple(runs))
        for name, (setting, runs) in zip(names, together, strict=True)
    ]


def _flat(config: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Returns dotted keys and values of nested mappings."""
    leaves: list[tuple[str, Any]] = []
    for name, value in config.items():
        key = f"{prefix}{name}"
        leaves += _flat(value, f"{key}.") if isinstance(value, dict) else [(key, value)]
    return leaves


def _with_values(config: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """Returns the configuration with other values of some dotted keys."""
    changed = dict(config)
    for key, value in values.items():
        group, _, name = key.partition(".")
        changed[group] = {**changed[group], name: value}
    return changed


def _label(
    name: str,
    setting: Mapping[str, Any],
    same_name: Sequence[Mapping[str, Any]],
    settings: Sequence[Mapping[str, Any]],
) -> str:
    """Returns the name, and the keys in which the setting differs from others.

    What makes up an agent is told where agents of the same name differ in it; all else also where
    agents of other names do.
    """
    keys = [
        key
        for key, value in setting.items()
        if any(other.get(key) != value for other in same_name)
        or (
            key.partition(".")[0] not in _OF_AN_AGENT
            and any(other.get(key, value) != value for other in settings)
        )
    ]
    # Two options of a group differ in many keys: the option says enough.
    options = {key.partition(".")[0] for key in keys if key.endswith(".name")}
    told = [f"{group}={setting[f'{group}.name']}" for group in sorted(options)]
    told += [f"{key}={setting[key]}" for key in keys if key.partition(".")[0] not in options]
    return ", ".join([name, *told])
