"""Checks of a command line's overrides against the options' schemas."""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from itertools import accumulate, filterfalse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException, MissingConfigException
from omegaconf import OmegaConf
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    InterpolationResolutionError,
    OmegaConfBaseException,
)
from yaml import YAMLError

from bbq_torchrl.options import CalibrateConfig, Config, EvaluateConfig, Option, schemas
from bbq_torchrl.options.registry import (
    EXPERIMENT,
    conf_folder,
    load_folder,
    options,
    options_folder,
)
from bbq_torchrl.options.task import keys_with_lists
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils.extras import install_command
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hydra.core.override_parser.types import Override

LAUNCHER = "hydra/launcher"
"""Hydra's group of launchers."""

LAUNCHER_EXTRAS = {"submitit_slurm": "slurm", "submitit_local": "slurm", "ray": "ray"}
"""Option of a plug-in that one of our launchers extends -> the extra that installs it."""

ONE_VALUE = "each key has one value in this command"

_LONGEST = 100_000  # characters of an override; Hydra's parser takes seconds for more
_DEEPEST = 20  # nested brackets; it takes minutes for thousands


def explain(error: Exception, overrides: Sequence[str], root: type, composed: Any = None) -> str:
    """Explains in one sentence why a configuration could not be composed.

    Args:
        error: the exception of Hydra or OmegaConf.
        overrides: the command line.
        root: the schema of the whole configuration.
        composed: the configuration of the command line's groups alone, if it can be composed; the
            other overrides are applied one by one to find the wrong one.
    """
    refusal = not_an_option(overrides, root) or _misread(overrides, root)
    if refusal is not None:
        return refusal
    if isinstance(error, MissingConfigException):
        return _missing_option(error)
    cause = error.__cause__ or error.__context__  # the context if a YAML file is at fault
    if isinstance(error, YAMLError):
        return f"a YAML file cannot be read: {sentence(error)}"
    if isinstance(cause, InterpolationResolutionError):
        return f"{cause.full_key}: {_first_line(cause)}" if cause.full_key else _first_line(cause)
    if not isinstance(error, HydraException):
        longest = max(overrides, key=len, default="the configuration")
        return unreadable(longest, getattr(error, "strerror", None) or _first_line(error))
    if composed is not None:
        for override in filterfalse(_chooses_options, overrides):
            if (refusal := _put(composed, override, root)) is not None:
                return refusal
    return _of_a_file(error, cause) or sentence(error)


def of_a_key(error: OmegaConfBaseException, key: str, got: str, root: type) -> str:
    """Returns a sentence on an unknown key, or on a value of the wrong type.

    Args:
        error: the exception of OmegaConf.
        key: the dotted key.
        got: the value as written.
        root: the schema of the whole configuration.
    """
    schema = error.object_type
    if isinstance(error, (ConfigKeyError, ConfigAttributeError)):
        if key.startswith("hydra.") and not is_dataclass(schema):  # an untyped mapping
            return unreadable(key, f"a new key of Hydra is added by a plus, +{key}=...")
        return unknown_key(key, schema if is_dataclass(schema) else root)
    if (text := allowed(key, schema)) is not None:
        return f"{key} must be {text}, got {got}"
    return _below_a_value(key) or f"{key}: {_first_line(error)}"


def read_override(override: str, parser: OverridesParser | None = None) -> Override:
    """Parses an override with Hydra's parser.

    Raises:
        ConfigError: it is not key=value.
    """
    try:
        (parsed,) = (parser or OverridesParser.create()).parse_overrides([override])
        return parsed
    except HydraException as error:
        hint = "write key=value, and quote special characters"
        raise ConfigError(unreadable(override, hint)) from error


def _misread(overrides: Sequence[str], root: type) -> str | None:
    """Returns a sentence on the first override that is not one key with one value."""
    for override in overrides:
        try:
            if read_override(override).is_sweep_override():
                return several_values(override, root)
        except ConfigError as error:
            return str(error)
        except (ValueError, RecursionError, OverflowError):
            continue  # a number of thousands of digits, which Hydra's error names
    for override in overrides:
        if override.startswith("~"):
            return f"{override} cannot be read: no key can be removed, each has a value"
        if (group := key_of(override)) in schemas() and group not in groups_of(root):
            return unknown_key(group, root)
    return None


def without_sweeps(overrides: Sequence[str]) -> list[str]:
    """Returns the overrides that all jobs of a sweep share."""
    return list(filterfalse(is_swept, overrides))


def is_swept(override: str) -> bool:
    """Returns whether an override has several values; False if it cannot be read."""
    with suppress(ConfigError, ValueError, RecursionError, OverflowError):
        return read_override(override).is_sweep_override()
    return False


def several_values(override: str, root: type) -> str:
    """Returns a sentence on a key with several values outside a sweep."""
    if root is not Config:
        return f"{override} has several values: {ONE_VALUE}"
    takes_a_list = key_of(override) in keys_with_lists(schemas())
    or_list = ", or put them in brackets for the replicas of one run" if takes_a_list else ""
    return f"{override} has several values: add --multirun to run them all{or_list}"


def _chooses_options(override: str) -> bool:
    group = key_of(override).partition("@")[0]
    return group in schemas() or group.partition("/")[0] in (EXPERIMENT, "hydra")


def group_choices(overrides: Sequence[str]) -> list[str]:
    """Returns the overrides that choose options."""
    return list(filter(_chooses_options, overrides))


def _put(composed: Any, override: str, root: type) -> str | None:
    """Applies an override to a configuration; returns a sentence if it does not fit."""
    parsed = read_override(override)
    key, is_added = parsed.key_or_group, parsed.is_add() or parsed.is_force_add()
    if parsed.is_add() and OmegaConf.select(composed, key, throw_on_missing=False) is not None:
        return unreadable(f"+{key}", f"an existing key is set without a plus, {key}=...")
    try:
        OmegaConf.update(composed, key, parsed.value(), merge=True, force_add=is_added)
    except OmegaConfBaseException as error:
        return of_a_key(error, key, _typed(override.partition("=")[2]), root)
    return None


def take_config_dir(arguments: Sequence[str]) -> list[str]:
    """Loads the folder of ``--config-dir``. Returns the command line without the flag.

    Raises:
        ConfigError: another flag, this one twice, or a folder that is missing or cannot be loaded.
    """
    refuse_second_folder(arguments)
    rest: list[str] = []
    given = iter(arguments)
    for argument in given:
        flag, equals, folder = argument.partition("=")
        if flag == "--config-dir":
            load_folder(folder if equals else next(given, ""))
        elif argument.startswith("-"):
            raise ConfigError(unreadable(argument))
        else:
            rest.append(argument)
    return rest


def key_of(override: str) -> str:
    """Returns the key or group of an override without its prefix."""
    return override.lstrip("+~").partition("=")[0]


def refuse_second_folder(arguments: Sequence[str]) -> None:
    """Refuses two folders of options; Hydra would take the last."""
    # Hydra's parser also takes -cd and abbreviations.
    if sum(argument.startswith(("--config-d", "-cd")) for argument in arguments) > 1:
        raise ConfigError("--config-dir can be given once only: one folder holds all options")


def too_large(overrides: Sequence[str]) -> str | None:
    """Returns a sentence on the first override that is too long or too deeply nested."""
    for override in overrides:
        if len(override) > _LONGEST:
            return unreadable(override, f"it has more than {_LONGEST} characters")
        depth = accumulate((letter in "[{(") - (letter in ")}]") for letter in override)
        if max(depth, default=0) > _DEEPEST:
            return unreadable(override, "it is nested too deeply")
    return None


def train_command() -> list[str]:
    """Returns the command that starts a training, with the folder of options if one is loaded.

    ``python train.py`` in a checkout, unless ``bbq`` is running; otherwise ``bbq train``.
    """
    folder = options_folder()
    flag = [] if folder is None else ["--config-dir", str(folder)]
    in_checkout = (conf_folder().parent / "train.py").is_file()
    by_file = in_checkout and Path(sys.argv[0]).stem != "bbq"
    return [*(["python", "train.py"] if by_file else ["bbq", "train"]), *flag]


def unreadable(override: str, hint: str = "write key=value") -> str:
    """Returns a sentence on an argument that cannot be read."""
    return f"{shown(override)} cannot be read: {hint}"


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0]


def _missing_option(error: MissingConfigException) -> str:
    missing = str(error.missing_cfg_file or "")
    for group in (*schemas(), EXPERIMENT, LAUNCHER):
        option = missing.removeprefix(f"{group}/")
        if group == LAUNCHER and option in LAUNCHER_EXTRAS:
            command = install_command(LAUNCHER_EXTRAS[option])
            return f"{group}={option} needs a package that is missing: {command}"
        if option != missing:
            file = re.match(rf"In '({group}/[^']+)'", _first_line(error))
            of = f"{file[1]}.yaml: " if file else ""
            return f"{of}{group} must be one of {', '.join(options(group))}, got {shown(option)}"
    return _first_line(error)


def _typed(text: str) -> str:
    """Returns a value as typed, in quotes unless it is a number."""
    with suppress(ValueError):
        float(text)
        return shown(text).strip("'")
    return shown(text)


def _below_a_value(key: str) -> str | None:
    """Returns a sentence on ``agent.lr.x``, whose parent is a key with a value."""
    parent = key.rpartition(".")[0]
    text = allowed(parent, None)
    return text and f"{sentence(key)} is not a key: {parent} has no keys, it must be {text}"


def allowed(key: str, schema: Any) -> str | None:
    """Returns the allowed values of a dotted key, as text; None for an unknown key.

    Args:
        key: such as ``agent.lr``.
        schema: the dataclass to search before all others.
    """
    group, _, name = key.rpartition(".")
    roots = () if group else (Config, EvaluateConfig, CalibrateConfig)
    for candidate in (schema, *roots, *schemas().get(group, {}).values()):
        item = getattr(candidate, "__dataclass_fields__", {}).get(name)
        if item is not None and "allowed" in item.metadata:
            return str(item.metadata["allowed"].text)
    return None


def _of_a_file(error: HydraException, cause: BaseException | None) -> str | None:
    """Returns a sentence on a YAML file, such as an experiment, that sets an unknown key."""
    # Only Hydra's message names the file.
    file = re.match(r"In '([^']+)'", str(error))
    if file is None or not isinstance(cause, (ConfigKeyError, ConfigAttributeError)):
        return None
    group = str(cause.full_key).rpartition(".")[0]
    place = _place(group, cause.object_type)
    # Without a known option, the file lacks its defaults.
    lacks = "; it lacks defaults: [<option>, _self_]" if place == group else ""
    return f"{file[1]} sets {cause.full_key}, which {place} does not have{lacks}"


def unknown_key(key: str, schema: Any) -> str:
    """Returns a sentence on a dotted key that the schema of its group lacks."""
    if (below := _below_a_value(key)) is not None:
        return below
    if schema in (Config, EvaluateConfig, CalibrateConfig):  # also an unknown group
        depth = 1
    else:
        depth = 2 if issubclass(schema, Option) else key.count(".") + 1
    parent, _, name = ".".join(key.split(".")[:depth]).rpartition(".")
    keys = [item.name for item in fields(schema)]
    close = get_close_matches(name, keys, n=1)
    hint = f" (did you mean {f'{parent}.' if parent else ''}{close[0]}?)" if close else ""
    place = _place(parent, schema)
    return f"{sentence(key)} is not a key{hint}; the keys of {place} are {', '.join(keys)}"


def _place(parent: str, schema: Any) -> str:
    options = [option for option, known in schemas().get(parent, {}).items() if known is schema]
    if len(options) == 1:
        return f"{parent}={options[0]}"
    return parent or "the configuration"


def groups_of(root: type) -> list[str]:
    """Returns the groups of options of a root."""
    return [item.name for item in fields(root) if item.name in schemas()]


def not_an_option(overrides: Sequence[str], root: type) -> str | None:
    """Returns a sentence on a group whose value is not the name of an option.

    Hydra by itself would read a mapping, ``agent={lr: 1}``, as changes to the default option.
    """
    groups = groups_of(root)
    for override in overrides:
        group, equals, value = override.partition("=")
        if group.lstrip("+") == EXPERIMENT and root is not Config:
            return f"{EXPERIMENT} is for training only: write the keys of {value} one by one"
        if re.match(r"[+~]*hydra[./]", group) and root is not Config:
            return f"{shown(override)} is for training only: this command has no such key"
        if key_of(override).startswith("hydra.sweeper.params."):
            return unreadable(override, "give a key its values, as --multirun seed=1,2")
        if equals and group == EXPERIMENT:
            return f"{EXPERIMENT} is added with a plus: write +{EXPERIMENT}={value}"
        if group.startswith("+") and group.lstrip("+") in groups:
            return f"{override} cannot be read: a group is chosen without a plus"
        if equals and group in groups and value.strip("'\"") not in options(group):
            several = "several options need --multirun" if root is Config else ONE_VALUE
            more = f"; {several}" if "," in value else ""
            return f"{group} must be one of {', '.join(options(group))}, got {shown(value)}{more}"
    return None
