"""Finished runs, read from their folders or from the table of an experiment.

A *run folder* contains ``config.yaml``, ``metrics.csv`` and ``result.json``. The *table of an
experiment* has many runs in two files, which ``scripts/keep_result.py`` writes::

    runs.json        {"config": what all runs share, by dotted key,
                      "runs": {name: {"config": the rest, "overrides": [...], "result": {...}}}}
    metrics.csv.xz   a row for each run, round and replica
"""

from __future__ import annotations

import csv
import json
import lzma
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

from bbq_torchrl.evaluation.curves import Metrics, numbers, read_metrics
from bbq_torchrl.evaluation.run_result import ReplicaResult, RunResult, flat, read_result, result_of
from bbq_torchrl.utils.files import CONFIG, METRICS, RESULT, folder_of, numbers_in_order, read_yaml
from bbq_torchrl.utils.text import sentence

RUNS, TABLE = "runs.json", "metrics.csv.xz"
"""The files of an experiment's table."""

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


@dataclass(frozen=True)
class Replica:
    """A trained replica of a finished run.

    Attributes:
        folder: the run folder, or the run's name below its experiment's folder.
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

        Keys with a list for the replicas have this replica's value; those of null are left out.
        """
        own = {
            key: value
            for key, value in flat(self.config).items()
            if key.partition(".")[0] not in _OF_A_SEED
            and key not in _OF_A_MACHINE
            and value is not None
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
        """Number of optimizer steps; NaN in metrics without it."""
        steps = self.metrics.columns.get("updates")
        return math.nan if steps is None else int(steps[:, self.number].sum())

    @property
    def agent(self) -> str:
        """The name of agent and exploration, such as ``BBQN-MAP``."""
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


def find_runs(places: Iterable[Path]) -> tuple[list[Path], list[Path]]:
    """Returns the finished runs and the unfinished ones in or below the folders, in their order.

    Finished are run folders with a result, and the tables of experiments. Unfinished are also runs
    extended to more rounds, and jobs of a sweep that never started.

    Raises:
        ValueError: a folder without any run, or no finished run at all.
    """
    finished: dict[Path, None] = {}
    unfinished: dict[Path, None] = {}
    for place in places:
        files = [file for name in (CONFIG, METRICS, RESULT, RUNS) for file in place.rglob(name)]
        found = {folder_of(file).resolve(): file for file in files}  # the last of these names
        for folder in sorted(found, key=numbers_in_order):
            file = found[folder]
            if file.name == RUNS or (file.name == RESULT and not _is_extended(folder)):
                finished[folder] = None
            elif file.name != CONFIG or _rounds(file) is not None:
                unfinished[folder] = None
        if not found.keys() & {*finished, *unfinished}:
            raise ValueError(f"{place} holds no run")
    if not finished:
        raise ValueError(f"no run is finished; not finished: {', '.join(map(str, unfinished))}")
    return [*finished], [*unfinished]


def _is_extended(folder: Path) -> bool:
    """Returns whether a run was extended beyond its result; False for a damaged file."""
    try:
        return bool(read_result(folder).rounds < _rounds(folder / CONFIG))
    except (ValueError, TypeError):
        return False


def _rounds(file: Path) -> Any:
    """Returns the rounds of a configuration; None if it is not a training's, or damaged."""
    try:
        return read_yaml(file.read_text(encoding="utf-8"))["protocol"]["rounds"]
    except (OSError, ValueError, TypeError, LookupError):
        return None


def read_runs(folder: Path) -> list[Replica]:
    """Reads a run folder, or all runs of an experiment's table. Returns the replicas.

    Raises:
        ValueError: a file is missing or damaged, or the files belong to different runs.
    """
    if (folder / RUNS).is_file():
        try:
            return [*_read_table(folder)]
        except (ValueError, LookupError, TypeError, EOFError, lzma.LZMAError) as error:
            raise ValueError(f"the table in {folder} is damaged: {sentence(error)}") from error
    result, metrics = read_result(folder), read_metrics(folder)
    try:
        config = read_yaml((folder / CONFIG).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{folder / CONFIG} cannot be read: {sentence(error)}") from error
    if not isinstance(config, dict) or not all(
        isinstance(config.get(group), dict) and "name" in config[group]
        for group in ("agent", "explore", "intrinsic")
    ):
        raise ValueError(f"{folder / CONFIG} is not the configuration of a run")
    return [*replicas_of(folder, config, result, metrics)]


def _read_table(folder: Path) -> Iterator[Replica]:
    """Yields the replicas of all runs of an experiment."""
    about = json.loads((folder / RUNS).read_text(encoding="utf-8"))
    with lzma.open(folder / TABLE, "rt", encoding="utf-8", newline="") as file:
        for name, of_run in groupby(csv.DictReader(file), key=lambda row: row.pop("run")):
            run, rows = about["runs"][name], [*of_run]
            columns = [column for column in rows[0] if any(row[column] for row in rows)]
            metrics = Metrics([numbers({key: row[key] for key in columns}) for row in rows])
            config = _nested(about["config"] | run["config"])
            yield from replicas_of(folder / name, config, result_of(run["result"]), metrics)


def _nested(flat_config: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the configuration of dotted keys."""
    config: dict[str, Any] = {}
    for key, value in flat_config.items():
        *groups, name = key.split(".")
        place = config
        for group in groups:
            place = place.setdefault(group, {})
        place[name] = value
    return config


def replicas_of(
    folder: Path, config: Mapping[str, Any], result: RunResult, metrics: Metrics
) -> Iterator[Replica]:
    """Yields the replicas of a run that did not diverge.

    Raises:
        ValueError: the metrics are of another run.
    """
    if (metrics.rounds, metrics.replicas) != (result.rounds, result.replicas):
        raise ValueError(
            f"{folder}: the metrics are of {metrics.rounds} rounds and {metrics.replicas} "
            f"replicas, the result of {result.rounds} and {result.replicas}"
        )
    for number in sorted({*range(result.replicas)} - {*result.diverged}):
        yield Replica(folder, number, config, result, metrics)


_AGENTS = {"bbqn": "BBQN", "bootstrap": "DQN-Bootstrap", "dqn": "DQN"}
"""``agent=`` -> its name in the paper."""

_PAIRS = {
    ("bbqn", "thompson"): "BBQN",
    ("bbqn", "thompson_boltzmann"): "Soft BBQN",
    ("bootstrap", "bootstrap"): "DQN-Bootstrap",
    ("dqn", "boltzmann"): "DQN-Boltzmann",
    ("dqn", "epsilon_greedy"): "DQN",
    ("dqn", "noisy"): "DQN",
}
"""(``agent=``, ``explore=``) -> the name of both."""


def agent_name(config: Mapping[str, Any]) -> str:
    """Returns a name such as ``BBQN-MAP`` or ``DQN-VIME-MC``, with ``explore=`` if it needs it.

    In BBQN-VIME-MC both targets and information gain use weight draws; if the two differ, both are
    named. Agents and intrinsic rewards from outside the package are named by their option in
    capitals.

    Args:
        config: the composed configuration, nested mappings.

    Examples:
        >>> bbqn, thompson = {"name": "bbqn", "target": "mc"}, {"name": "thompson"}
        >>> vime = {"name": "vime", "weights": "mc"}
        >>> agent_name({"agent": bbqn, "explore": thompson, "intrinsic": vime})
        'BBQN-VIME-MC'
        >>> agent_name({"agent": bbqn, "explore": {"name": "greedy"}, "intrinsic": vime})
        'BBQN-VIME-MC, explore=greedy'
    """
    agent, explore, intrinsic = (config[group] for group in ("agent", "explore", "intrinsic"))
    option, reward, acting = agent["name"], intrinsic["name"], explore["name"]
    gain = intrinsic["weights"].upper() if reward == "vime" else ""
    pair, target, kinds = _PAIRS.get((option, acting)), "", ""
    is_noisy = option == "dqn" and bool(agent.get("noisy"))
    if is_noisy != (acting == "noisy"):  # the noise explores
        pair = None
    if option in _AGENTS:
        kinds = "Double " * bool(agent.get("double")) + "Noisy " * is_noisy
        target = agent.get("target", "").upper()
    parts = [kinds + (pair or _AGENTS.get(option, option.upper()))]
    parts += [target if target != gain else "", reward.upper() if reward != "none" else "", gain]
    return "-".join(filter(None, parts)) + (f", explore={acting}" if pair is None else "")
