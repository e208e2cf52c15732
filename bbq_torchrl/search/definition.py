"""The configuration of a search: what varies, between which bounds, and what counts as good.

``conf/search/<name>.yaml`` holds the space and what is fixed; the command line may change both::

    search=bbqn search.trials=30 search.space.agent.lr.high=0.003 replicas=3 protocol=quick

What begins with ``search`` is the search's, everything else is an override of ``train.py`` that
all trials have.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf

from bbq_torchrl.options.registry import config_folders, options
from bbq_torchrl.options.settings import (
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
from bbq_torchrl.runs.compose import compose, load_yaml
from bbq_torchrl.runs.overrides import too_large, unreadable
from bbq_torchrl.search.space import Parameter, as_entry, parse_parameter
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
        "where the search is kept",
    )
    trials: int = setting(50, COUNT, "trials in all, of all processes together")
    objective: str = setting(
        "training",
        one_of("training", "final"),
        "success of all training dialogues (area under the curve), or of the final evaluation",
    )
    statistic: str = setting("mean", one_of("mean", "iqm"), "how a trial's replicas are summed up")
    sampler: str = setting("tpe", one_of("tpe", "random"), "how values are chosen")
    pruner: str = setting(
        "median", one_of("median", "none"), "median: stop a trial that is below the others' median"
    )
    startup_trials: int = setting(
        10, COUNT, "trials at random before the sampler and the pruner go by results"
    )
    prune_after: float = setting(0.25, BELOW_ONE, "share of its rounds that every trial is given")
    seed: int = setting(0, SEED, "seed of the sampler")
    storage: str | None = setting(
        None, optional(ANY_TEXT, "SQLite in the folder"), "URL of another database of Optuna's"
    )


@dataclass(frozen=True)
class Search:
    """A search that has been checked.

    Attributes:
        name: of its YAML file.
        settings: how it searches.
        space: key to what it may be.
        fixed: the overrides of ``train.py`` that all trials have.
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
        """The command line of ``train.py`` for a trial's values."""
        return [*self.fixed, *(_override(name, value) for name, value in values.items())]

    @cached_property
    def corners(self) -> list[Config]:
        """Trials between which all others lie, one key at a bound or at another choice each time.

        Raises:
            ConfigError: values that cannot be run.
        """
        lowest = {name: item.probes[0] for name, item in self.space.items()}
        others = [
            {**lowest, name: value}
            for name, item in self.space.items()
            for value in item.probes[1:]
        ]
        return [self.config(values) for values in (lowest, *others)]

    def config(self, values: Mapping[str, Any]) -> Config:
        """The configuration of a trial.

        Raises:
            ConfigError: the values cannot be run.
        """
        return compose(self.overrides(values))

    def definition(self) -> dict[str, Any]:
        """All that the outcomes of trials depend on, as plain values by dotted key."""
        settings = asdict(self.settings)
        for free in ("folder", "trials", "storage"):
            del settings[free]
        return {
            **{f"{SEARCH}.{key}": value for key, value in settings.items()},
            **{f"{_SPACE}{name}": as_entry(item) for name, item in self.space.items()},
            "fixed": sorted(self.fixed),
        }


def compose_search(arguments: Sequence[str]) -> Search:
    """The checked search that a command line stands for.

    Args:
        arguments: ``search=<name>``, keys of the search, and overrides of ``train.py``. A key that
            is given a value there does not vary.

    Raises:
        ConfigError: one sentence that names the key that is wrong and what it may be.

    Examples:
        >>> search = compose_search(["search=bbqn", "search.trials=9", "agent.prior_std=.1"])
        >>> list(search.space), search.settings.trials
        (['agent.mean_init', 'agent.std_init', 'agent.kl_temperature'], 9)
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
        _refuse_several(key, override)
        if key.partition(".")[0].partition("/")[0] in _REFUSED:
            raise ConfigError(f"{sentence(override)} cannot be part of a search")
        given.pop(key, None)
    space = {name: parse_parameter(f"{_SPACE}{name}", item) for name, item in given.items()}
    if not space:
        raise ConfigError(f"{SEARCH}.space must have a key that varies, but all are given")
    name = Path(chosen[0]).stem
    checked = filled(SearchConfig, settings, f"{SEARCH}.")
    search = Search(name, checked, space, tuple(fixed.values()))
    _ = search.corners  # composed now: no trial fails for its values
    return search


def _refuse_several(key: str, override: str) -> None:
    """Refuses ``key=1,2``: what varies in a search is written as a choice."""
    try:
        several = OverridesParser.create().parse_override(override).is_sweep_override()
    except HydraException:
        return  # refused with the others, when they are composed
    if several:
        raise ConfigError(
            f"{sentence(override)} has several values: in a search write "
            f"{_SPACE}{key}={{type: categorical, choices: [...]}}"
        )


def _read(chosen: str) -> tuple[dict[str, Any], dict[str, Any], dict[str, str]]:
    """Settings, space and what is fixed by the file of a search: ours by name, or a path."""
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
        raise ConfigError(f"{file} must have the key space, a mapping of keys to what they may be")
    fixed = plain.pop("fixed", None) or []
    if not isinstance(fixed, list) or not all("=" in str(item) for item in fixed):
        raise ConfigError(f"{file}: fixed must be a list of key=value, got {shown(fixed)}")
    space = {str(name): value for name, value in plain.pop("space").items()}
    by_key = {str(item).partition("=")[0].lstrip("+"): str(item) for item in fixed}
    return {str(key): value for key, value in plain.items()}, space, by_key


def _value(argument: str, text: str) -> Any:
    if not text:
        return text  # which YAML would take for null
    conceal_environment(text)
    try:
        parsed = OmegaConf.from_dotlist([f"value={text}"])
        return OmegaConf.to_container(parsed, resolve=True)["value"]  # type: ignore[index, call-overload]
    except Exception as error:
        raise ConfigError(unreadable(argument)) from error


def _change_space(space: dict[str, Any], key: str, value: Any) -> None:
    """Takes in ``<key>={type: ...}``, ``<key>=null`` (does not vary) or ``<key>.<field>=...``."""
    if value is None:
        if space.pop(key, key) is key:
            raise ConfigError(f"{_SPACE}{key} does not vary; {_what_varies(space)}")
    elif isinstance(value, dict):
        space[key] = value
    else:
        name, _, entry = key.rpartition(".")
        if not isinstance(space.get(name), dict):
            raise ConfigError(
                f"{_SPACE}{key} is not a key: {name} does not vary; {_what_varies(space)}"
            )
        space[name] = {**space[name], entry: value}


def _what_varies(space: Mapping[str, Any]) -> str:
    return f"what varies is {', '.join(space)}"


def _override(name: str, value: Any) -> str:
    return f"{name}={value if isinstance(value, str) else json.dumps(value)}"
