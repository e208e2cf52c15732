"""Finished runs, read from their result folders.

A *result folder* contains ``config.yaml``, ``metrics.csv`` and ``result.json``. It is a run folder,
or a copy by ``scripts/keep_result.py``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.evaluation.run_result import flat, read_result
from bbq_torchrl.utils.files import CONFIG, METRICS, RESULT, folder_of, numbers_in_order, read_yaml
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from bbq_torchrl.evaluation.curves import Metrics
    from bbq_torchrl.evaluation.run_result import ReplicaResult, RunResult


_OF_A_SEED = ("seed", "replicas", "resume", "device", "threads", "logger")
"""Keys and groups in which runs of one setting may differ."""

_OF_A_MACHINE = (
    "protocol.checkpoint_every",
    "protocol.keep_checkpoints",
    "protocol.eval_batch",
    # Evaluation during training does not affect the training.
    "protocol.eval_every",
    "protocol.eval_every_dialogues",
)

_NAMED = ("agent", "explore")
"""Groups that every run's configuration has, with the option's name."""


@dataclass(frozen=True)
class Replica:
    """A trained replica of a finished run.

    Attributes:
        folder: the result folder.
        number: the replica's number.
        config: the run's composed configuration, nested mappings.
        result: the run's result.
        metrics: the run's training metrics.
    """

    folder: Path
    number: int
    config: Mapping[str, Any]
    result: RunResult
    metrics: Metrics

    @property
    def own(self) -> ReplicaResult:
        """The replica's part of the result."""
        return self.result.per_replica[self.number]

    @cached_property
    def setting(self) -> dict[str, Any]:
        """Dotted key -> value of everything but the seed that affects the outcome.

        Keys with a list for the replicas have this replica's value.
        """
        own = {
            key: value
            for key, value in flat(self.config).items()
            if key.partition(".")[0] not in _OF_A_SEED and key not in _OF_A_MACHINE
        }
        return own | self.own.values | {"protocol.rounds": self.result.rounds}

    @property
    def member(self) -> tuple[int, int, str, int]:
        """Identifier of the replica's random numbers: equal members share them.

        The run's seed, its number of replicas (whose random numbers are drawn together), the type
        of its device, and the replica's number.
        """
        replicas = int(self.config.get("replicas", self.result.replicas))
        device = str(self.config.get("device", "cpu")).partition(":")[0]
        return self.result.seed, replicas, device, self.number

    @property
    def updates(self) -> float:
        """Number of optimizer steps; NaN in metrics of versions without it."""
        if "updates" not in self.metrics.columns:
            return math.nan
        return int(self.metrics["updates"][:, self.number].sum())

    @property
    def agent(self) -> str:
        """The agent as the paper calls it, such as ``BBQN-MAP``."""
        return agent_name(self.config)


def distinguishing_keys(keys: Iterable[str]) -> list[str]:
    """Reduces the keys in which two settings differ: a different option replaces its keys.

    Args:
        keys: all keys in which the two settings differ.

    Examples:
        >>> distinguishing_keys(["env.every", "env.name", "env.start", "spike.dialogues"])
        ['env.name', 'spike.dialogues']
    """
    keys = list(keys)
    options = {key.partition(".")[0] for key in keys if names_option(key)}
    return [key for key in keys if names_option(key) or key.partition(".")[0] not in options]


def names_option(key: str) -> bool:
    """Returns whether a dotted key names an option, such as ``explore.name``."""
    return key.partition(".")[2] == "name"


def find_results(places: Iterable[Path]) -> list[Path]:
    """Returns the folders of finished runs in or below the given folders.

    Raises:
        ValueError: no finished run, or a folder without any run.
    """
    found: dict[Path, None] = {}
    nothing: list[ValueError] = []
    for place in places:
        folders = sorted((file.parent for file in place.rglob(RESULT)), key=numbers_in_order)
        finished = [folder.resolve() for folder in folders if not _is_extended(folder)]
        if not finished:
            reason = f"no {RESULT} is in or below it"
            if folders:
                reason = f"the {RESULT} in {folders[0]} is of fewer rounds than {CONFIG} asks for"
            nothing.append(ValueError(f"{place} holds no finished run: {reason}"))
            if not find_unfinished([place]):
                raise nothing[-1]
        found.update(dict.fromkeys(finished))
    if nothing and not found:
        raise nothing[0]
    return list(found)


def find_unfinished(places: Iterable[Path]) -> list[Path]:
    """Returns the unfinished run folders in or below the given folders.

    Those include runs extended to more rounds, and jobs of a sweep that never started.
    """
    files = [file for place in places for name in (CONFIG, METRICS) for file in place.rglob(name)]
    known = {folder_of(file).resolve(): file for file in files}  # the metrics if they exist
    unfinished = (
        folder
        for folder, file in known.items()
        if (file.name == METRICS or _is_of_a_run(file))
        and (not (folder / RESULT).is_file() or _is_extended(folder))
    )
    return sorted(unfinished, key=numbers_in_order)


def _is_of_a_run(file: Path) -> bool:
    """Returns whether a configuration belongs to a training, not to another program."""
    config = _readable(file)
    return isinstance(config, dict) and {"agent", "protocol"} <= config.keys()


def _is_extended(folder: Path) -> bool:
    """Returns whether a run was extended beyond its result; False for a damaged file."""
    try:
        rounds = _readable(folder / CONFIG)["protocol"]["rounds"]
        return bool(read_result(folder).rounds < rounds)
    except (OSError, ValueError, TypeError, LookupError):
        return False


def _readable(file: Path) -> Any:
    """Returns the content of a YAML file; None if it cannot be read."""
    try:
        return read_yaml(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def read_run(folder: Path) -> list[Replica]:
    """Reads a result folder. Returns its replicas.

    Raises:
        ValueError: a file is missing or damaged, or the files belong to different runs.
    """
    result, metrics = read_result(folder), read_metrics(folder)
    if (metrics.rounds, metrics.replicas) != (result.rounds, result.replicas):
        raise ValueError(
            f"{folder}: the metrics are of {metrics.rounds} rounds and {metrics.replicas} "
            f"replicas, the result of {result.rounds} and {result.replicas}"
        )
    try:
        config = read_yaml((folder / CONFIG).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{folder / CONFIG} cannot be read: {sentence(error)}") from error
    groups = [config.get(name) for name in _NAMED] if isinstance(config, dict) else [None]
    named = all(isinstance(group, dict) and "name" in group for group in groups)
    if not named or not isinstance(config.get("replicas", 1), int):
        raise ValueError(f"{folder / CONFIG} is not the configuration of a run")
    replicas = range(result.replicas)
    return [Replica(folder, number, config, result, metrics) for number in replicas]


_OF_THE_PAPER = {"bbqn": "BBQN", "bootstrap": "DQN-Bootstrap", "dqn": "DQN"}
"""``agent=`` -> its name in the paper."""


def agent_name(config: Mapping[str, Any]) -> str:
    """Returns a name such as ``BBQN-MAP`` or ``DQN-VIME-MC``.

    In BBQN-VIME-MC both targets and information gain use weight draws; if the two differ, both are
    named. Agents and intrinsic rewards from outside the package are named by their option in
    capitals.

    Args:
        config: the composed configuration, nested mappings; groups unknown to older versions may be
            absent.

    Examples:
        >>> agent_name({"agent": {"name": "dqn"}, "explore": {"name": "boltzmann"}})
        'DQN-Boltzmann'
        >>> bbqn = {"agent": {"name": "bbqn", "target": "mc"}, "explore": {"name": "thompson"}}
        >>> agent_name(bbqn | {"intrinsic": {"name": "vime", "weights": "mc"}})
        'BBQN-VIME-MC'
        >>> bbqn["explore"]["name"], bbqn["agent"]["target"] = "thompson_boltzmann", "map"
        >>> agent_name(bbqn)
        'Soft BBQN-MAP'
        >>> agent_name({"agent": {"name": "polyak"}, "intrinsic": {"name": "visits"}})
        'POLYAK-VISITS'
    """
    option, intrinsic = str(config["agent"]["name"]), config.get("intrinsic") or {}
    is_known = option in _OF_THE_PAPER
    agent, explore = (config["agent"], config.get("explore") or {}) if is_known else ({}, {})
    target = str(agent["target"]).upper() if agent.get("target") else None
    reward = str(intrinsic.get("name", "none"))
    gain = str(intrinsic["weights"]).upper() if reward == "vime" else None
    name = _OF_THE_PAPER.get(option, option.upper())
    if agent.get("noisy"):
        name = f"Noisy {name}"
    if agent.get("double"):
        name = f"Double {name}"
    if explore.get("name") == "thompson_boltzmann":
        name = f"Soft {name}"
    parts = [name]
    if explore.get("name") == "boltzmann":
        parts.append("Boltzmann")
    if target is not None and target != gain:
        parts.append(target)
    if reward != "none":
        parts.append(reward.upper())
    if gain is not None:
        parts.append(gain)
    return "-".join(parts)
