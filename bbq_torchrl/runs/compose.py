"""Composing configurations by Hydra into checked dataclasses, and the help on their keys."""

from __future__ import annotations

import argparse
import contextlib
import copy
import inspect
import json
import os
import re
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, Field, fields
from functools import reduce
from operator import getitem
from pathlib import Path
from textwrap import wrap
from typing import Any, TypeVar

from hydra import compose as hydra_compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.utils import to_absolute_path
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from bbq_torchrl.options import (
    CalibrateConfig,
    Config,
    EvaluateConfig,
    Option,
    schemas,
    validate,
)
from bbq_torchrl.options.registry import (
    EXPERIMENT,
    conf_folder,
    load_folder,
    options,
    options_folder,
)
from bbq_torchrl.options.root import ROOTS, register_options
from bbq_torchrl.settings import ConfigError, walk
from bbq_torchrl.utils.output import page
from bbq_torchrl.utils.text import sentence, shown

Root = TypeVar("Root", Config, EvaluateConfig, CalibrateConfig)


def compose(
    overrides: Sequence[str] = (),
    root: type[Root] = Config,  # type: ignore[assignment]
    run: Config | None = None,
) -> Root:
    """Returns the checked configuration of a command line.

    Args:
        overrides: as on the command line, such as ``["agent=dqn", "protocol.rounds=20"]``.
        root: :class:`Config` for a training, :class:`EvaluateConfig` for an evaluation.
        run: a run that provides the options that the command line omits, with their keys.

    Raises:
        ConfigError: Hydra cannot compose it, or the first invalid value or combination.

    Examples:
        >>> compose(["agent=dqn"]).explore.name
        'epsilon_greedy'
        >>> compose(["env=domain_ext"]).protocol.rounds
        200
    """
    given = set(map(key_of, overrides))
    of_run: set[str] = {
        item.name for item in fields(root) if item.name in schemas() and run is not None
    }
    chosen: list[str] = [f"{group}={getattr(run, group).name}" for group in sorted(of_run - given)]
    with session():
        composed = compose_raw([*chosen, *overrides], root)
        for key, _, value in walk(run) if run is not None else ():
            if key.partition(".")[0] in of_run - given and key not in given:
                OmegaConf.update(composed, key, value)
        return to_config(composed, root)


@contextlib.contextmanager
def session() -> Iterator[None]:
    """Opens a Hydra session on the ``conf`` folder, and restores the previous one at the end."""
    register_options()
    before = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(conf_folder()), version_base="1.3"):
            yield
    finally:
        GlobalHydra.instance().hydra = before  # initialize_config_dir leaves a copy


def compose_raw(overrides: Sequence[str], root: type = Config) -> DictConfig:
    """Composes YAML files and overrides in a :func:`session`, with Hydra's part.

    Values have their keys' types but are not checked further.

    Raises:
        ConfigError: Hydra cannot compose them; the message is Hydra's.
    """
    try:
        folder = options_folder()
        added = [] if folder is None else [f"hydra.searchpath=[{quoted(f'file://{folder}')}]"]
        return hydra_compose(ROOTS[root], [*added, *overrides], return_hydra_config=True)
    except (HydraException, OmegaConfBaseException, YAMLError) as error:
        cause = f": {sentence(error.__cause__)}" if error.__cause__ else ""
        raise ConfigError(f"{sentence(error)}{cause}") from error


def to_config(composed: DictConfig, root: type[Root]) -> Root:
    """Returns the checked dataclass of a composed configuration. Paths become absolute.

    Raises:
        ConfigError: a missing value, or the first invalid value or combination.
    """
    typed = copy.deepcopy(composed)
    with open_dict(typed):
        typed.pop("hydra", None)
    try:
        config: Root = OmegaConf.to_object(typed)  # type: ignore[assignment]
    except OmegaConfBaseException as error:
        # the reference in it says enough of a value that may be a secret
        told = re.sub(r"(interpolation '.*': Value) '.*' of", r"\1 of", sentence(error))
        raise ConfigError(told) from error
    for key, item, value in walk(config):
        if item.metadata["allowed"].per_replica:
            _put(config, key, _number(value))
    for part in (config, *vars(config).values()):
        if isinstance(part, (root, Option)):
            for key in vars(part).keys() - part.__dataclass_fields__.keys():  # added by a plus
                raise ConfigError(f"{key} is not a key of {type(part).__name__}")
    if path := getattr(config.domain, "path", ""):
        # Relative to where the command started: with hydra.job.chdir=true a job runs elsewhere.
        config.domain.path = os.path.abspath(to_absolute_path(os.path.expanduser(path)))  # type: ignore[attr-defined]
    try:
        validate(config)
    except ConfigError:
        written: Any = OmegaConf.to_container(typed, resolve=False)
        for key, _, value in walk(config):
            raw = reduce(getitem, key.split("."), written)
            _put(config, key, _referenced(value, raw))
        validate(config)  # again, with references in the sentence
        raise
    return config


def _put(config: object, key: str, value: object) -> None:
    *groups, name = key.split(".")
    setattr(reduce(getattr, groups, config), name, value)


def _number(value: Any) -> Any:
    """Returns the number that a text, such as an environment variable, stands for."""
    if isinstance(value, list):
        return [_number(item) for item in value]
    with contextlib.suppress(ValueError):
        return float(value) if isinstance(value, str) else value
    return value


class _Reference(str):
    """A text that is shown as the reference that it came from, such as ``${oc.env:TOKEN}``."""

    written: str

    def __repr__(self) -> str:
        return repr(self.written)


def _referenced(value: Any, written: Any) -> Any:
    if isinstance(value, list) and isinstance(written, list):
        return [_referenced(*both) for both in zip(value, written, strict=True)]
    if not isinstance(value, str) or "${" not in str(written):
        return value
    reference = _Reference(value)
    reference.written = str(written)
    return reference


def key_of(override: str) -> str:
    """Returns the key or group of an override without its prefix."""
    return override.lstrip("+~").partition("=")[0]


def value_of(overrides: Sequence[str], key: str) -> str | None:
    """Returns the text that a command line gives for a key; None without one."""
    given = [override for override in overrides if key_of(override) == key]
    try:
        parsed = OverridesParser.create().parse_overrides(given)
    except HydraException as error:
        raise ConfigError(sentence(error)) from error
    return str(parsed[-1].value()) if parsed else None


def quoted(path: Path | str) -> str:
    """Returns a path quoted for Hydra."""
    text = os.fspath(path).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{text}'"


def take_config_dir(arguments: Sequence[str]) -> list[str]:
    """Loads the folder of ``--config-dir``, if given. Returns the other arguments.

    Raises:
        ConfigError: the folder is missing or cannot be loaded.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd")
    given, others = parser.parse_known_args(arguments)
    if given.config_dir is not None:
        load_folder(given.config_dir)
    return others


def train_command() -> list[str]:
    """Returns the command that starts a training, with the folder of options if one is loaded.

    ``python train.py`` in a checkout, unless ``bbq`` is running; otherwise ``bbq train``.
    """
    folder = options_folder()
    flag = [] if folder is None else ["--config-dir", str(folder)]
    in_checkout = (conf_folder().parent / "train.py").is_file()
    by_file = in_checkout and Path(sys.argv[0]).stem != "bbq"
    return [*(["python", "train.py"] if by_file else ["bbq", "train"]), *flag]


_BEGIN = """\
Trains an agent on task-oriented dialogues and evaluates it.

usage: bbq train [<group>=<option> ...] [<key>=<value> ...] [--multirun]
       bbq train --help [<group> | <group>=<option> | <key> ...]    meaning and values of keys
"""

_END = f"""\
Examples
  bbq train agent=bbqn explore=thompson env=domain_ext
  bbq train protocol.rounds=20 replicas=3 domain=miulab domain.path=<folder>
  bbq train replicas=4 'agent.prior_std=[.05,.1,.2,.4]'
  bbq train --multirun agent=bbqn,dqn 'seed=range(0,3)'
  bbq train resume=<run folder>

--cfg job prints all keys of a command. All keys: {page("configuration")}
"""


def usage(words: Sequence[str] = ()) -> str:
    """Returns the help of ``bbq train``.

    Args:
        words: groups, options (``agent=dqn``) and keys (``agent.lr``) to explain; without any, all
            groups and options are listed.

    Raises:
        ConfigError: a word names no group, option or key.
    """
    lines = [line for word in words for line in _explained(word)]
    return "\n".join(lines or [_BEGIN, *_overview(), "", _END.rstrip()]) + "\n"


def _overview() -> Iterator[str]:
    yield from _keys(Config)
    for group, known in schemas().items():
        yield f"\n{group}="
        yield from (f"  {name:<20} {summary(schema)}" for name, schema in known.items())
    places = defaultdict(list)
    for name in options(EXPERIMENT):
        folder, _, file = name.rpartition("/")
        places[folder].append(file)
    yield f"\n+{EXPERIMENT}="
    for folder, names in places.items():
        start = f"  {folder + '/' if folder else '':<20} "
        yield from wrap(", ".join(names), 100, initial_indent=start, subsequent_indent=" " * 23)


def _explained(word: str) -> Iterator[str]:
    """Yields the lines about a group, an option or a key."""
    name, _, value = word.partition("=")
    group, _, key = name.partition(".")
    known = schemas().get(group, {})
    chosen = {value: known[value]} if value in known else known
    having: dict[str, list[str]] = defaultdict(list)
    if name in _by_name(Config):
        yield from _keys(Config, key=name)
    elif not key and chosen:
        for option, schema in chosen.items():
            yield f"{group}={option}: {summary(schema)}"
            yield from _keys(schema, f"{group}.")
    else:
        for option, schema in chosen.items():
            for line in _keys(schema, f"{group}.", key):
                having[line].append(option)
        if not having:
            text = "--help takes groups, options and keys of bbq train"
            raise ConfigError(f"{text}, got {shown(word)}")
        yield from (f"{line} ({', '.join(names)})" for line, names in having.items())


def _by_name(schema: type) -> dict[str, Field[Any]]:
    groups = {"name", *schemas()}
    return {item.name: item for item in fields(schema) if item.name not in groups}


def _keys(schema: type, prefix: str = "", key: str | None = None) -> Iterator[str]:
    """Yields a line for each key, or for one, with default, meaning and what is allowed."""
    for name, item in _by_name(schema).items():
        if key in (None, name):
            allowed = item.metadata["allowed"].text
            start = f"  {prefix}{name}={default(item)}"
            yield f"{start:<34} {item.metadata['meaning']}; {allowed}"


def summary(schema: type) -> str:
    """Returns the first paragraph of an option's docstring, as one line."""
    return " ".join((inspect.getdoc(schema) or "").split("\n\n")[0].split())


def default(item: Field[Any]) -> str:
    """Returns a key's default as YAML."""
    value = item.default if item.default_factory is MISSING else item.default_factory()
    return str(value) if isinstance(value, str) else json.dumps(value)
