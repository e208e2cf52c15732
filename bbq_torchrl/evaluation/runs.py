"""Finished runs, as their result folders tell them.

A *result folder* holds ``config.yaml``, ``metrics.csv`` and ``result.json``: a run folder is one,
and so is what ``scripts/keep_result.py`` keeps of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from bbq_torchrl.evaluation.metrics import Metrics, read_metrics
from bbq_torchrl.evaluation.names import agent_name
from bbq_torchrl.evaluation.results import RunResult, read_result
from bbq_torchrl.run_folder import CONFIG, METRICS, RESULT
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

__all__ = ["Member", "Run", "find_results", "find_unfinished", "read_run", "telling"]

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


def telling(keys: Iterable[str]) -> list[str]:
    """Returns the keys that tell settings apart: where an option differs, its name says enough.

    Examples:
        >>> telling(["env.every", "env.name", "env.start", "spike.dialogues"])
        ['env.name', 'spike.dialogues']
    """
    keys = list(keys)
    options = {key.partition(".")[0] for key in keys if key.endswith(".name")}
    return [key for key in keys if key.endswith(".name") or key.partition(".")[0] not in options]


def find_results(places: Iterable[Path]) -> list[Path]:
    """Returns the folders of finished runs that are, or lie anywhere below, the given folders.

    Raises:
        ValueError: there is none in one of them.
    """
    found: dict[Path, None] = {}
    for place in places:
        if (place / RESULT).is_file():
            folders = [place]
        else:
            folders = sorted(file.parent for file in place.rglob(RESULT))
        finished = [folder.resolve() for folder in folders if not _is_extended(folder)]
        if not finished:
            reason = f"no {RESULT} is in or below it"
            if folders:
                reason = f"the {RESULT} in {folders[0]} is of fewer rounds than {CONFIG} asks for"
            raise ValueError(f"{place} holds no finished run: {reason}")
        found.update(dict.fromkeys(finished))
    return list(found)


def find_unfinished(places: Iterable[Path]) -> list[Path]:
    """Returns the run folders in or below the given folders that have metrics and no result yet.

    The result of a run that goes on to more rounds is none yet.
    """
    folders = {file.parent.resolve() for place in places for file in place.rglob(METRICS)}
    return sorted(
        folder for folder in folders if not (folder / RESULT).is_file() or _is_extended(folder)
    )


def _is_extended(folder: Path) -> bool:
    """Whether a run with a result goes on to more rounds; not where a file is damaged."""
    try:
        rounds = yaml.safe_load((folder / CONFIG).read_text(encoding="utf-8"))["protocol"]["rounds"]
        return bool(read_result(folder).rounds < rounds)
    except (OSError, ValueError, TypeError, LookupError, yaml.YAMLError, RecursionError):
        return False  # reading the run says what is wrong


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
        config = yaml.safe_load((folder / CONFIG).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        deep = isinstance(error, RecursionError)
        reason = "it is nested too deeply" if deep else sentence(error)
        raise ValueError(f"{folder / CONFIG} cannot be read: {reason}") from error
    groups = [config.get(name) for name in _NAMED] if isinstance(config, dict) else [None]
    named = all(isinstance(group, dict) and "name" in group for group in groups)
    if not named or not isinstance(config.get("replicas", 1), int):
        raise ValueError(f"{folder / CONFIG} is not the configuration of a run")
    return Run(folder, config, result, metrics)


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
