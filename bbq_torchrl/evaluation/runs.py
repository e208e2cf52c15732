"""Finished runs, as their result folders tell them.

A *result folder* holds ``config.yaml``, ``metrics.csv`` and ``result.json``: a run folder is one,
and so is what ``scripts/keep_result.py`` keeps of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from bbq_torchrl.evaluation.metrics import read_metrics
from bbq_torchrl.evaluation.results import read_result
from bbq_torchrl.utils.files import CONFIG, METRICS, RESULT, folder_of, numbers_in_order, read_yaml
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from bbq_torchrl.evaluation.metrics import Metrics
    from bbq_torchrl.evaluation.results import ReplicaResult, RunResult


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


@dataclass(frozen=True)
class Replica:
    """A trained replica of a finished run, as the result folder tells it.

    Attributes:
        folder: the result folder.
        number: of the replica.
        config: the composed configuration of the run, nested mappings.
        result: of the run's final evaluation.
        metrics: of the run's training.
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
        """Dotted key to value of all that decides the outcome, but for the seed.

        Of a key with a list, a value for each replica, it is the replica's own.
        """
        flat = {
            key: value
            for key, value in _flat(self.config)
            if key.partition(".")[0] not in _OF_A_SEED and key not in _OF_A_MACHINE
        }
        return flat | self.own.values | {"protocol.rounds": self.result.rounds}

    @property
    def member(self) -> tuple[int, int, str, int]:
        """Identifies the random numbers it trained with: equal members share them.

        The run's seed, how many replicas it has (random numbers are drawn for all of them
        together), the type of its device, and the replica's number.
        """
        replicas = int(self.config.get("replicas", self.result.replicas))
        device = str(self.config.get("device", "cpu")).partition(":")[0]
        return self.result.seed, replicas, device, self.number

    @property
    def updates(self) -> float:
        """Steps of the optimizer; NaN in metrics of versions that lack them."""
        if "updates" not in self.metrics.columns:
            return math.nan
        return int(self.metrics["updates"][:, self.number].sum())

    @property
    def agent(self) -> str:
        """The agent as the paper calls it, such as ``BBQN-MAP``."""
        return agent_name(self.config)


def distinguishing_keys(keys: Iterable[str]) -> list[str]:
    """Returns which keys tell two settings apart: where an option differs, its name says enough.

    Args:
        keys: all in which the two differ. Keys in which any of several settings differ would not
            do: of three options two can be the same, and differ in another key.

    Examples:
        >>> distinguishing_keys(["env.every", "env.name", "env.start", "spike.dialogues"])
        ['env.name', 'spike.dialogues']
    """
    keys = list(keys)
    options = {key.partition(".")[0] for key in keys if names_option(key)}
    return [key for key in keys if names_option(key) or key.partition(".")[0] not in options]


def names_option(key: str) -> bool:
    """Returns whether a dotted key is the name of a group's option: ``explore.name``."""
    return key.partition(".")[2] == "name"


def find_results(places: Iterable[Path]) -> list[Path]:
    """Returns the folders of finished runs that are, or lie anywhere below, the given folders.

    Raises:
        ValueError: there is none at all, or one of the folders holds no run.
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
    """Returns the run folders in or below the given folders that have no result yet.

    Those include runs that continue to more rounds, and jobs of a sweep that never began.
    """
    files = [file for place in places for name in (CONFIG, METRICS) for file in place.rglob(name)]
    known = {folder_of(file).resolve(): file for file in files}  # the metrics where there are
    unfinished = (
        folder
        for folder, file in known.items()
        if (file.name == METRICS or _is_of_a_run(file))
        and (not (folder / RESULT).is_file() or _is_extended(folder))
    )
    return sorted(unfinished, key=numbers_in_order)


def _is_of_a_run(file: Path) -> bool:
    """Returns whether a configuration is a training's; other programs have files of that name."""
    config = _readable(file)
    return isinstance(config, dict) and {"agent", "protocol"} <= config.keys()


def _is_extended(folder: Path) -> bool:
    """Returns whether a run with a result continues to more rounds; False for a damaged file."""
    try:
        rounds = _readable(folder / CONFIG)["protocol"]["rounds"]
        return bool(read_result(folder).rounds < rounds)
    except (OSError, ValueError, TypeError, LookupError):
        return False


def _readable(file: Path) -> Any:
    """Returns what a YAML file holds; None where that cannot be told: reading the run says why."""
    try:
        return read_yaml(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def read_run(folder: Path) -> list[Replica]:
    """Reads a result folder. Returns its replicas.

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
        config = read_yaml((folder / CONFIG).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{folder / CONFIG} cannot be read: {sentence(error)}") from error
    groups = [config.get(name) for name in _NAMED] if isinstance(config, dict) else [None]
    named = all(isinstance(group, dict) and "name" in group for group in groups)
    if not named or not isinstance(config.get("replicas", 1), int):
        raise ValueError(f"{folder / CONFIG} is not the configuration of a run")
    replicas = range(result.replicas)
    return [Replica(folder, number, config, result, metrics) for number in replicas]


def _flat(config: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Returns dotted keys and values of nested mappings."""
    leaves: list[tuple[str, Any]] = []
    for name, value in config.items():
        key = f"{prefix}{name}"
        leaves += _flat(value, f"{key}.") if isinstance(value, dict) else [(key, value)]
    return leaves


_OF_THE_PAPER = {"bbqn": "BBQN", "bootstrap": "DQN-Bootstrap", "dqn": "DQN"}
"""``agent=`` -> its name. What keys of other agents mean is not known here."""


def agent_name(config: Mapping[str, Any]) -> str:
    """Returns a name such as ``BBQN-MAP`` or ``DQN-VIME-MC``.

    BBQN-VIME-MC stands for targets and information gain both at weight draws; where the two
    differ, both are named. An agent or an intrinsic reward that does not come with the package is
    called by its option's name, in capitals, whatever keys it has.

    Args:
        config: the composed configuration, nested mappings; groups that a version did not have
            yet may be absent.

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
