"""Checks of a command line's overrides against the options' schemas, refused in one sentence."""

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

from bbq_torchrl.options import (
    CalibrateConfig,
    Config,
    ConfigError,
    EvaluateConfig,
    Option,
    schemas,
)
from bbq_torchrl.options.registry import (
    EXPERIMENT,
    conf_folder,
    load_folder,
    options,
    options_folder,
)
from bbq_torchrl.options.values import keys_with_lists
from bbq_torchrl.utils.extras import install_command
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hydra.core.override_parser.types import Override

LAUNCHER = "hydra/launcher"
"""The group of the launchers, Hydra's own."""

LAUNCHER_EXTRAS = {"submitit_slurm": "slurm", "submitit_local": "slurm", "ray": "ray"}
"""Plug-in's option that a launcher of ours extends -> the extra that installs the plug-in."""

ONE_VALUE = "each key has one value in this command"

_LONGEST = 100_000  # characters of an override: Hydra's parser takes seconds for more
_DEEPEST = 20  # brackets within brackets: it takes minutes for thousands


def explain(error: Exception, overrides: Sequence[str], root: type, composed: Any = None) -> str:
    """One sentence for a configuration that could not be composed.

    Args:
        error: what Hydra or OmegaConf raised.
        overrides: the command line it was composed from.
        root: the schema of the whole configuration.
        composed: what the groups of the command line alone compose to, if that can be: the other
            overrides are put on it one by one, until one does not fit.
    """
    refusal = not_an_option(overrides, root) or _misread(overrides, root)
    if refusal is not None:
        return refusal
    if isinstance(error, MissingConfigException):
        return _missing_option(error)
    cause = error.__cause__ or error.__context__  # the latter where a YAML file is at fault
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
    """One sentence for a key that its schema lacks, or whose value has another type.

    Args:
        error: what OmegaConf raised.
        key: the dotted key.
        got: the value as it was written.
        root: the schema of the whole configuration.
    """
    schema = error.object_type
    if isinstance(error, (ConfigKeyError, ConfigAttributeError)):
        if key.startswith("hydra.") and not is_dataclass(schema):  # a mapping, which takes any key
            return unreadable(
                key, f"a key of Hydra that is not there is added by a plus, +{key}=..."
            )
        return unknown_key(key, schema if is_dataclass(schema) else root)
    if (text := allowed(key, schema)) is not None:
        return f"{key} must be {text}, got {got}"
    return _below_a_value(key) or f"{key}: {_first_line(error)}"


def read_override(override: str, parser: OverridesParser | None = None) -> Override:
    """Returns an override as Hydra reads it.

    Raises:
        ConfigError: it is no key and value.
    """
    try:
        (parsed,) = (parser or OverridesParser.create()).parse_overrides([override])
        return parsed
    except HydraException as error:
        hint = "write key=value, and quote special characters"
        raise ConfigError(unreadable(override, hint)) from error


def _misread(overrides: Sequence[str], root: type) -> str | None:
    """A sentence for an override that is no key and one value."""
    for override in overrides:
        try:
            if read_override(override).is_sweep_override():
                return several_values(override, root)
        except ConfigError as error:
            return str(error)
        except (ValueError, RecursionError, OverflowError):
            continue  # a number of thousands of digits, which Hydra's error tells of
    for override in overrides:
        if override.startswith("~"):
            return f"{override} cannot be read: no key can be removed, each has a value"
        if (group := key_of(override)) in schemas() and group not in groups_of(root):
            return unknown_key(group, root)
    return None


def without_sweeps(overrides: Sequence[str]) -> list[str]:
    """Returns the overrides of a sweep that are the same in all its jobs."""

    def is_swept(override: str) -> bool:
        with suppress(ConfigError, ValueError, RecursionError, OverflowError):
            return read_override(override).is_sweep_override()
        return False

    return list(filterfalse(is_swept, overrides))


def several_values(override: str, root: type) -> str:
    """A sentence for a sweep over a key where there is to be one run."""
    if root is not Config:
        return f"{override} has several values: {ONE_VALUE}"
    takes_a_list = key_of(override) in keys_with_lists(schemas())
    or_list = ", or put them in brackets for the replicas of one run" if takes_a_list else ""
    return f"{override} has several values: add --multirun to run them all{or_list}"


def _chooses_options(override: str) -> bool:
    group = key_of(override).partition("@")[0]
    return group in schemas() or group.partition("/")[0] in (EXPERIMENT, "hydra")


def group_choices(overrides: Sequence[str]) -> list[str]:
    """Returns the overrides that choose options, whose keys the others change."""
    return list(filter(_chooses_options, overrides))


def _put(composed: Any, override: str, root: type) -> str | None:
    """Changes one key of a configuration; a sentence if that cannot be."""
    parsed = read_override(override)
    key, is_added = parsed.key_or_group, parsed.is_add() or parsed.is_force_add()
    if parsed.is_add() and OmegaConf.select(composed, key, throw_on_missing=False) is not None:
        return unreadable(f"+{key}", f"a key that there is already goes without a plus, {key}=...")
    try:
        OmegaConf.update(composed, key, parsed.value(), merge=True, force_add=is_added)
    except OmegaConfBaseException as error:
        return of_a_key(error, key, _typed(override.partition("=")[2]), root)
    return None


def take_config_dir(arguments: Sequence[str]) -> list[str]:
    """Returns a command line without ``--config-dir <folder>``, whose options are loaded.

    Raises:
        ConfigError: any other flag, this one twice, no folder behind it, or one that cannot be
            loaded.
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
    """Returns the key or group of an override, without the marks in front of it."""
    return override.lstrip("+~").partition("=")[0]


def refuse_second_folder(arguments: Sequence[str]) -> None:
    """Refuses a command line with two folders of options, of which Hydra would take the last."""
    # Hydra's parser also takes -cd and a flag that is cut short.
    if sum(argument.startswith(("--config-d", "-cd")) for argument in arguments) > 1:
        raise ConfigError("--config-dir can be given once only: one folder holds all options")


def too_large(overrides: Sequence[str]) -> str | None:
    """A sentence for an override that is too long or too deep to be worth reading."""
    for override in overrides:
        if len(override) > _LONGEST:
            return unreadable(override, f"it has more than {_LONGEST} characters")
        depth = accumulate((letter in "[{(") - (letter in ")}]") for letter in override)
        if max(depth, default=0) > _DEEPEST:
            return unreadable(override, "it is nested too deeply")
    return None


def train_command() -> list[str]:
    """Returns how a training is called, with the folder of options if there is one.

    That is ``python train.py`` in a checkout, unless the command ``bbq`` runs, and ``bbq train``.
    """
    folder = options_folder()
    flag = [] if folder is None else ["--config-dir", str(folder)]
    in_checkout = (conf_folder().parent / "train.py").is_file()
    by_file = in_checkout and Path(sys.argv[0]).stem != "bbq"
    return [*(["python", "train.py"] if by_file else ["bbq", "train"]), *flag]


def unreadable(override: str, hint: str = "write key=value") -> str:
    """One sentence for a part of a command line that is no key and value."""
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
    """Returns a value as it was typed: in quotes, but for a number."""
    with suppress(ValueError):
        float(text)
        return shown(text).strip("'")
    return shown(text)


def _below_a_value(key: str) -> str | None:
    """A sentence for ``agent.lr.x``, whose parent is a key with a value."""
    parent = key.rpartition(".")[0]
    text = allowed(parent, None)
    return text and f"{sentence(key)} is not a key: {parent} has no keys, it must be {text}"


def allowed(key: str, schema: Any) -> str | None:
    """Returns what a dotted key must be.

    Args:
        key: such as ``agent.lr``.
        schema: the dataclass that has it; where it is none, the key is looked up.
    """
    group, _, name = key.rpartition(".")
    roots = () if group else (Config, EvaluateConfig, CalibrateConfig)
    for candidate in (schema, *roots, *schemas().get(group, {}).values()):
        item = getattr(candidate, "__dataclass_fields__", {}).get(name)
        if item is not None and "allowed" in item.metadata:
            return str(item.metadata["allowed"].text)
    return None


def _of_a_file(error: HydraException, cause: BaseException | None) -> str | None:
    """A sentence for a YAML file, such as an experiment's, that sets what there is not."""
    # Only Hydra's message says which file it was reading.
    file = re.match(r"In '([^']+)'", str(error))
    if file is None or not isinstance(cause, (ConfigKeyError, ConfigAttributeError)):
        return None
    group = str(cause.full_key).rpartition(".")[0]
    place = _place(group, cause.object_type)
    # Where no option is known yet, the file does not say which it changes.
    lacks = "; it lacks defaults: [<option>, _self_]" if place == group else ""
    return f"{file[1]} sets {cause.full_key}, which {place} does not have{lacks}"


def unknown_key(key: str, schema: Any) -> str:
    """One sentence for a dotted key that the schema of its group lacks."""
    if (below := _below_a_value(key)) is not None:
        return below
    if schema in (Config, EvaluateConfig, CalibrateConfig):  # a group that there is not, too
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
    """Returns the groups of options that a whole configuration has."""
    return [item.name for item in fields(root) if item.name in schemas()]


def not_an_option(overrides: Sequence[str], root: type) -> str | None:
    """A sentence for a group that was given something else than the name of an option.

    Hydra itself takes a mapping, ``agent={lr: 1}``, for changes to whatever option is the default.
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
