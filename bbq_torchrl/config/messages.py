"""Hydra's and OmegaConf's refusals, said in one sentence that names what is allowed."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from hydra.errors import MissingConfigException, OverrideParseException
from omegaconf.errors import InterpolationResolutionError, OmegaConfBaseException, ValidationError

from bbq_torchrl.config.launchers import LAUNCHER, LAUNCHER_EXTRAS
from bbq_torchrl.config.schema import EXPERIMENT, SCHEMAS, Config, EvaluateConfig
from bbq_torchrl.config.values import keys_with_lists

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["explain", "unknown_key"]


def explain(
    error: Exception,
    overrides: Sequence[str],
    options: Callable[[str], list[str]],
    root: type = Config,
) -> str:
    """One sentence for a configuration that could not be composed.

    Args:
        error: what Hydra or OmegaConf raised.
        overrides: the command line it was composed from.
        options: the options of a group.
        root: the schema of the whole configuration.
    """
    cause = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    if isinstance(error, OverrideParseException):
        return f"{error.override!r} cannot be read: write key=value, and quote special characters"
    if isinstance(error, MissingConfigException):
        return _missing_option(error, options)
    if isinstance(cause, InterpolationResolutionError):
        return f"{cause.full_key}: {_first_line(cause)}" if cause.full_key else _first_line(cause)
    if isinstance(cause, ValidationError):
        return _wrong_type(cause, overrides)
    return (
        _not_an_option(overrides, options, root)
        or _several_values(error)
        or _removed(overrides)
        or _unknown_key(error, cause, root)
        or " ".join(str(error).split())
    )


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0]


def _missing_option(error: MissingConfigException, options: Callable[[str], list[str]]) -> str:
    missing = str(error.missing_cfg_file or "")
    group, _, option = missing.partition("/")
    if missing.startswith(f"{LAUNCHER}/"):
        group, option = LAUNCHER, missing.removeprefix(f"{LAUNCHER}/")
        if option in LAUNCHER_EXTRAS:
            extra = LAUNCHER_EXTRAS[option]
            return (
                f"{group}={option} needs a package that is missing: "
                f"pip install 'bbq-torchrl[{extra}]'"
            )
    if group in (*SCHEMAS, EXPERIMENT, LAUNCHER):
        return f"{group} must be one of {', '.join(options(group))}, got {option!r}"
    return _first_line(error)


def _wrong_type(error: ValidationError, overrides: Sequence[str]) -> str:
    key = str(error.full_key or "").split("[")[0]
    given = _given(key, overrides)
    got = f", got {given}" if given is not None else f": {_first_line(error)}"
    allowed = _allowed(key, error.object_type)
    if allowed is not None:
        return f"{key} must be {allowed}{got}"
    if key in SCHEMAS:
        return f"{key} must be one option, as {key}={next(iter(SCHEMAS[key]))}{got}"
    return f"{key}: {_first_line(error)}"


def _given(key: str, overrides: Sequence[str]) -> str | None:
    for override in reversed(overrides):
        name, equals, value = override.partition("=")
        if equals and name.lstrip("+") == key:
            return repr(value)
    return None


def _allowed(key: str, schema: Any) -> str | None:
    """What the field of a dotted key allows; the schema is looked up where none is given."""
    group, _, name = key.rpartition(".")
    candidates = [schema, Config, EvaluateConfig, *SCHEMAS.get(group, {}).values()]
    for candidate in candidates:
        if not is_dataclass(candidate):
            continue
        for item in fields(candidate):
            if item.name == name and "allowed" in item.metadata:
                return str(item.metadata["allowed"].text)
    return None


def _several_values(error: Exception) -> str | None:
    match = re.match(r"(?:Ambiguous value for argument|Sweep parameters) '([^']+)'", str(error))
    if match is None:
        return None
    given = match[1]
    takes_a_list = given.partition("=")[0] in keys_with_lists(SCHEMAS)
    or_list = ", or put them in brackets for the replicas of one run" if takes_a_list else ""
    return f"{given} has several values: add --multirun to run them all{or_list}"


def _removed(overrides: Sequence[str]) -> str | None:
    removed = next((item for item in overrides if item.startswith("~")), None)
    return removed and f"{removed} cannot be read: no key can be removed, each has a value"


def _unknown_key(error: Exception, cause: BaseException | None, root: type) -> str | None:
    match = re.match(r"(?:Could not (?:\w+) |Key )[^']*'([^']+)'", _first_line(error))
    if match is None:
        return None
    key = match.group(1).lstrip("+~").partition("=")[0]
    schema = getattr(cause, "object_type", None)
    return unknown_key(key, schema if is_dataclass(schema) else root)


def unknown_key(key: str, schema: Any) -> str:
    """One sentence for a dotted key that the schema of its group lacks."""
    parent, _, name = key.rpartition(".")
    keys = [item.name for item in fields(schema)]
    close = get_close_matches(name, keys, n=1)
    hint = f" (did you mean {f'{parent}.' if parent else ''}{close[0]}?)" if close else ""
    return f"{key} is not a key{hint}; the keys of {_place(parent, schema)} are {', '.join(keys)}"


def _place(parent: str, schema: Any) -> str:
    options = [option for option, known in SCHEMAS.get(parent, {}).items() if known is schema]
    if len(options) == 1:
        return f"{parent}={options[0]}"
    return parent or "the configuration"


def _not_an_option(
    overrides: Sequence[str], options: Callable[[str], list[str]], root: type
) -> str | None:
    """A sentence for a group that was given something else than the name of an option."""
    groups = [item.name for item in fields(root) if item.name in SCHEMAS]
    for override in overrides:
        group, equals, value = override.partition("=")
        if group.lstrip("+") == EXPERIMENT and root is not Config:
            return f"{EXPERIMENT} is for training only: write the keys of {value} one by one"
        if equals and group == EXPERIMENT:
            return f"{EXPERIMENT} is added with a plus: write +{EXPERIMENT}={value}"
        if group.startswith("+") and group.lstrip("+") in groups:
            return f"{override} cannot be read: a group is chosen without a plus"
        if equals and group in groups and value not in options(group):
            sweep = "; several options need --multirun" if "," in value else ""
            return f"{group} must be one of {', '.join(options(group))}, got {value!r}{sweep}"
    return None
