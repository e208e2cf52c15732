"""The configuration of a search: space, fixed keys and objective.

``conf/search/<name>.yaml`` has the space and the fixed keys; the command line can change both::

    search=bbqn search.trials=30 search.space.agent.lr.high=0.003 replicas=3 protocol=quick

Keys that begin with ``search`` belong to the search; all others are overrides of ``train.py`` that
all trials share.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import OmegaConf

from bbq_torchrl.options.registry import config_folders, options
from bbq_torchrl.runs.compose import compose, load_yaml
from bbq_torchrl.runs.overrides import is_swept, too_large, unreadable
from bbq_torchrl.search.space import Parameter, as_entry, parse_parameter
from bbq_torchrl.settings import (
    ANY_TEXT,
    BELOW_ONE,
    COUNT,
    SEED,
    ConfigError,
    filled,
    one_of,
    optional,
    setting,
)
from bbq_torchrl.utils.text import conceal_environment, sentence, shown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.options import Config

SEARCH = "search"
"""Prefix of the search's keys, and the folder of its YAML files."""

_SPACE = f"{SEARCH}.space."
_REFUSED = ("resume", "hydra")


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
        "training",
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
        space: key -> its possible values.
        fixed: the overrides of ``train.py`` that all trials share.
    """

    name: str
    settings: SearchConfig
    space: dict[str, Parameter]
    fixed: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """The folder of the search."""
        chosen = self.settings.folder or f"runs/search_{self.name}"
        return Path(expanduser(chosen)).resolve()

    def overrides(self, values: Mapping[str, Any]) -> list[str]:
        """Returns the command line of ``train.py`` for a trial's values."""
        return [*self.fixed, *(_override(name, value) for name, value in values.items())]

    @cached_property
    def corners(self) -> list[Config]:
        """Configurations at the edges of the space: each changes one key to a bound or choice.

        Raises:
            ConfigError: invalid values.
        """
        lowest = {name: item.probes[0] for name, item in self.space.items()}
        others = [
            {**lowest, name: value}
            for name, item in self.space.items()
            for value in item.probes[1:]
        ]
        return [self.config(values) for values in (lowest, *others)]

    def config(self, values: Mapping[str, Any]) -> Config:
        """Returns the configuration of a trial.

        Raises:
            ConfigError: invalid values.
        """
        return compose(self.overrides(values))

    def definition(self) -> dict[str, Any]:
        """Returns everything that outcomes depend on, as plain values by dotted key."""
        settings = asdict(self.settings)
        for free in ("folder", "trials", "storage"):
            del settings[free]
        return {
            **{f"{SEARCH}.{key}": value for key, value in settings.items()},
            **{f"{_SPACE}{name}": as_entry(item) for name, item in self.space.items()},
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
    if (refusal := too_large(arguments)) is not None:
        raise ConfigError(refusal)
    chosen = [text.partition("=")[2] for text in arguments if text.partition("=")[0] == SEARCH]
    if len(chosen) != 1:
        raise ConfigError(f"{SEARCH} must be given once, as one of {', '.join(options(SEARCH))}")
    settings, given, fixed = _read(chosen[0])
    for argument in arguments:
        key, equals, text = argument.partition("=")
        if not equals or argument.startswith("-"):
            raise ConfigError(unreadable(argument))
        if key.startswith(_SPACE):
            _change_space(given, key.removeprefix(_SPACE), _value(argument, text))
        elif key.startswith(f"{SEARCH}."):
            settings[key.removeprefix(f"{SEARCH}.")] = _value(argument, text)
        elif key != SEARCH:
            fixed[key.lstrip("+")] = argument
    for key, override in fixed.items():
        if is_swept(override):
            raise ConfigError(
                f"{sentence(override)} has several values: in a search write "
                f"{_SPACE}{key}={{type: categorical, choices: [...]}}"
            )
        if key.partition(".")[0].partition("/")[0] in _REFUSED:
            raise ConfigError(f"{sentence(override)} cannot be part of a search")
        given.pop(key, None)
    space = {name: parse_parameter(f"{_SPACE}{name}", item) for name, item in given.items()}
    if not space:
        raise ConfigError(f"{SEARCH}.space must have a key that varies, but all are given")
    name = Path(chosen[0]).stem
    checked = filled(SearchConfig, settings, f"{SEARCH}.")
    search = Search(name, checked, space, tuple(fixed.values()))
    _ = search.corners  # composed now, to refuse invalid values
    return search


def _read(chosen: str) -> tuple[dict[str, Any], dict[str, Any], dict[str, str]]:
    """Returns settings, space and fixed overrides from the YAML file of a search."""
    own = chosen.endswith((".yaml", ".yml"))
    if not own and chosen not in options(SEARCH):
        raise ConfigError(
            f"{SEARCH} must be one of {', '.join(options(SEARCH))} or a YAML file, "
            f"got {shown(chosen)}"
        )
    places = [folder / SEARCH / f"{chosen}.yaml" for folder in config_folders()]
    file = Path(expanduser(chosen)) if own else next(place for place in places if place.is_file())
    plain = OmegaConf.to_container(load_yaml(file, "a search"), resolve=False)
    if not isinstance(plain, dict) or not isinstance(plain.get("space"), dict):
        raise ConfigError(f"{file} must have the key space, a mapping of keys to their values")
    fixed = plain.pop("fixed", None) or []
    if not isinstance(fixed, list) or not all("=" in str(item) for item in fixed):
        raise ConfigError(f"{file}: fixed must be a list of key=value, got {shown(fixed)}")
    space = {str(name): value for name, value in plain.pop("space").items()}
    by_key = {str(item).partition("=")[0].lstrip("+"): str(item) for item in fixed}
    return {str(key): value for key, value in plain.items()}, space, by_key


def _value(argument: str, text: str) -> Any:
    if not text:
        return text  # YAML would read null
    conceal_environment(text)
    try:
        parsed = OmegaConf.from_dotlist([f"value={text}"])
        return OmegaConf.to_container(parsed, resolve=True)["value"]  # type: ignore[index, call-overload]
    except Exception as error:
        raise ConfigError(unreadable(argument)) from error


def _change_space(space: dict[str, Any], key: str, value: Any) -> None:
    """Applies ``<key>={type: ...}``, ``<key>=null`` (does not vary) or ``<key>.<field>=...``."""
    if value is None:
        if space.pop(key, key) is key:
            raise ConfigError(f"{_SPACE}{key} does not vary; {_varying_keys(space)}")
    elif isinstance(value, dict):
        space[key] = value
    else:
        name, _, entry = key.rpartition(".")
        if not isinstance(space.get(name), dict):
            raise ConfigError(
                f"{_SPACE}{key} is not a key: {name} does not vary; {_varying_keys(space)}"
            )
        space[name] = {**space[name], entry: value}


def _varying_keys(space: Mapping[str, Any]) -> str:
    return f"the keys that vary are {', '.join(space)}"


def _override(name: str, value: Any) -> str:
    return f"{name}={value if isinstance(value, str) else json.dumps(value)}"
