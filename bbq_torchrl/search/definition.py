"""The configuration of a search: space, fixed keys and objective.

``conf/search/<name>.yaml`` has the space and the fixed keys; the command line can change both::

    search=bbqn search.trials=30 search.space.agent.lr.high=0.003 replicas=3 protocol=quick

Keys that begin with ``search`` belong to the search; all others are overrides of ``train.py`` that
all trials share. An entry of the space has the arguments of Optuna's ``suggest_<type>``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os.path import expanduser
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import config_folders, options
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.settings import (
    ANY_TEXT,
    BELOW_ONE,
    BOOLEAN,
    COUNT,
    SEED,
    ConfigError,
    check,
    filled,
    one_of,
    optional,
    setting,
)

SEARCH = "search"
"""Prefix of the search's keys, and the folder of its YAML files."""


@dataclass
class SearchConfig:
    """The keys ``search.<key>``."""

    folder: str | None = setting(
        None,
        optional(ANY_TEXT, "runs/search_ and its name"),
        "folder of the search",
    )
    trials: int = setting(50, COUNT, "number of trials of all processes together")
    objective: str = setting(
        "early",
        one_of("training", "early", "final"),
        "success of all training dialogues (area under the curve), its mean with that of the first "
        "third of the rounds, or success of the final evaluation",
    )
    statistic: str = setting("mean", one_of("mean", "iqm"), "statistic over a trial's replicas")
    sampler: str = setting("tpe", one_of("tpe", "random"), "sampler of the values")
    pruner: str = setting(
        "median", one_of("median", "none"), "median: stop a trial below the median of the others"
    )
    startup_trials: int = setting(10, COUNT, "random trials before sampler and pruner use results")
    prune_after: float = setting(
        0.25, BELOW_ONE, "share of its rounds before a trial can be stopped"
    )
    seed: int = setting(0, SEED, "seed of the sampler")
    storage: str | None = setting(
        None, optional(ANY_TEXT, "SQLite in the folder"), "URL of another database of Optuna's"
    )


@dataclass(frozen=True)
class Search:
    """A checked search.

    Attributes:
        name: the name of its YAML file.
        settings: the keys ``search.<key>``.
        space: key -> ``type`` (float, int or categorical) and the arguments of ``suggest_<type>``.
        fixed: the overrides of ``train.py`` that all trials share.
    """

    name: str
    settings: SearchConfig
    space: dict[str, dict[str, Any]]
    fixed: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """The folder of the search."""
        chosen = self.settings.folder or f"runs/search_{self.name}"
        return Path(expanduser(chosen)).resolve()

    def overrides(self, values: Mapping[str, Any]) -> list[str]:
        """Returns the command line of ``train.py`` for a trial's values."""
        return [*self.fixed, *(_override(key, value) for key, value in values.items())]

    def config(self, values: Mapping[str, Any]) -> Config:
        """Returns the configuration of a trial.

        Raises:
            ConfigError: invalid values.
        """
        return compose(self.overrides(values))

    @cached_property
    def corners(self) -> list[Config]:
        """Configurations at the edges of the space: each changes one key to a bound or choice.

        Raises:
            ConfigError: invalid values.
        """
        edges = {
            key: entry["choices"] if "choices" in entry else [entry["low"], entry["high"]]
            for key, entry in self.space.items()
        }
        first = {key: values[0] for key, values in edges.items()}
        changed = [{**first, key: one} for key, values in edges.items() for one in values[1:]]
        return [self.config(values) for values in (first, *changed)]

    def definition(self) -> dict[str, Any]:
        """Returns everything that outcomes depend on, as plain values by dotted key."""
        settings = vars(self.settings).items()
        free = ("folder", "trials", "storage")
        return {
            **{f"{SEARCH}.{key}": value for key, value in settings if key not in free},
            **{f"{SEARCH}.space.{key}": entry for key, entry in self.space.items()},
            "fixed": sorted(self.fixed),
        }


def compose_search(arguments: Sequence[str]) -> Search:
    """Returns the checked search of a command line.

    Args:
        arguments: ``search=<name>``, keys of the search, and overrides of ``train.py``, whose keys
            do not vary.

    Raises:
        ConfigError: one sentence that names the wrong key and its allowed values.

    Examples:
        >>> search = compose_search(["search=vime", "search.trials=9", "protocol.lr=.001"])
        >>> list(search.space), search.settings.trials
        (['intrinsic.eta', 'intrinsic.weights', 'protocol.epochs', 'protocol.batch_size'], 9)
    """
    chosen = [text.partition("=")[2] for text in arguments if text.startswith(f"{SEARCH}=")]
    if len(chosen) != 1:
        raise ConfigError(f"{SEARCH} must be given once, as one of {', '.join(options(SEARCH))}")
    given, fixed = _read(_file(chosen[0]))
    for argument in arguments:
        key, equals, text = argument.partition("=")
        if not equals:
            raise ConfigError(f"arguments must be <key>=<value>, got {argument}")
        if key.startswith(f"{SEARCH}."):
            # YAML would read an empty text as null.
            value = OmegaConf.from_dotlist([f"value={text}"])["value"] if text else text
            OmegaConf.update(given, key.removeprefix(f"{SEARCH}."), value, merge=False)
        elif key != SEARCH:
            fixed[key.lstrip("+")] = argument
    if refused := {"resume", "hydra"} & {re.split("[./]", key)[0] for key in fixed}:
        raise ConfigError(f"{refused.pop()} cannot be part of a search")
    space = {
        key: _checked_entry(f"{SEARCH}.space.{key}", entry)
        for key, entry in _entries(given.pop("space", None), "")
        if key not in fixed
    }
    if not space:
        raise ConfigError(f"{SEARCH}.space must have a key that varies, got none")
    plain: Any = OmegaConf.to_container(given)
    settings = filled(SearchConfig, plain, f"{SEARCH}.")
    search = Search(Path(chosen[0]).stem, settings, space, tuple(fixed.values()))
    _ = search.corners  # composed now, to refuse invalid values
    return search


def _file(chosen: str) -> Path:
    """Returns the YAML file of a search: one of ours by its name, or the user's own."""
    if chosen.endswith((".yaml", ".yml")):
        return Path(expanduser(chosen))
    places = [folder / SEARCH / f"{chosen}.yaml" for folder in config_folders()]
    if found := [place for place in places if place.is_file()]:
        return found[0]
    known = ", ".join(options(SEARCH))
    raise ConfigError(f"{SEARCH} must be one of {known} or a YAML file, got {chosen!r}")


def _read(file: Path) -> tuple[DictConfig, dict[str, str]]:
    """Returns a search's settings with its space, nested by dots, and its fixed overrides."""
    given = OmegaConf.load(file)
    if not isinstance(given, DictConfig) or not OmegaConf.is_dict(given.get("space")):
        raise ConfigError(f"{file} must have the key space, a mapping of keys to their values")
    # unresolved: they may refer to keys of a trial
    fixed: Any = OmegaConf.to_container(given.pop("fixed", None) or OmegaConf.create([]))
    space = OmegaConf.create()
    for key, entry in given.space.items():
        OmegaConf.update(space, str(key), entry)
    given.space = space
    return given, {item.partition("=")[0].lstrip("+"): item for item in map(str, fixed)}


def _entries(node: Any, prefix: str) -> list[tuple[str, dict[str, Any]]]:
    """Returns the entries of a nested space by dotted key; null: the key does not vary."""
    if not OmegaConf.is_dict(node):
        if node is None:
            return []
        raise ConfigError(f"{SEARCH}.space.{prefix} must be a mapping with a type, got {node!r}")
    if "type" in node:
        plain = OmegaConf.to_container(node, resolve=True)
        assert isinstance(plain, dict)
        return [(prefix, {str(name): value for name, value in plain.items()})]
    within = [_entries(node[name], f"{prefix}.{name}".strip(".")) for name in node]
    return [entry for entries in within for entry in entries]


def _checked_entry(key: str, entry: dict[str, Any]) -> dict[str, Any]:
    from optuna import distributions

    kinds = {
        "float": distributions.FloatDistribution,
        "int": distributions.IntDistribution,
        "categorical": distributions.CategoricalDistribution,
    }
    arguments = {name: value for name, value in entry.items() if name != "type"}
    if entry["type"] not in kinds:
        raise ConfigError(f"{key}.type must be one of {', '.join(kinds)}, got {entry['type']!r}")
    check(f"{key}.log", entry.get("log", False), BOOLEAN, ConfigError)
    try:
        kinds[entry["type"]](**arguments)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{key}: {error}") from error
    return entry


def _override(key: str, value: Any) -> str:
    return f"{key}={value if isinstance(value, str) else json.dumps(value)}"
