"""Hydra's and OmegaConf's refusals, said in one sentence that names what is allowed."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from hydra.errors import MissingConfigException, OverrideParseException
from omegaconf.errors import InterpolationResolutionError, OmegaConfBaseException, ValidationError

from bbq_torchrl.config.schema import EXPERIMENT, SCHEMAS, Config, EvaluateConfig

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["explain"]


def explain(error: Exception, overrides: Sequence[str], options: Callable[[str], list[str]]) -> str:
    """One sentence for a configuration that could not be composed.

    Args:
        error: what Hydra or OmegaConf raised.
        overrides: the command line it was composed from.
        options: the options of a group.
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
        _not_an_option(overrides, options)
        or _unknown_key(error, cause)
        or " ".join(str(error).split())
    )


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0]


def _missing_option(error: MissingConfigException, options: Callable[[str], list[str]]) -> str:
    group, _, option = str(error.missing_cfg_file or "").partition("/")
    if group in (*SCHEMAS, EXPERIMENT):
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


def _unknown_key(error: Exception, cause: BaseException | None) -> str | None:
    match = re.match(r"(?:Could not (?:\w+) |Key )[^']*'([^']+)'", _first_line(error))
    if match is None:
        return None
    key = match.group(1).lstrip("+~").partition("=")[0]
    parent, _, name = key.rpartition(".")
    schema = getattr(cause, "object_type", None)
    if not is_dataclass(schema):
        schema = Config
    keys = [item.name for item in fields(schema)]
    close = get_close_matches(name, keys, n=1)
    hint = f" (did you mean {f'{parent}.' if parent else ''}{close[0]}?)" if close else ""
    return f"{key} is not a key{hint}; the keys of {_place(parent, schema)} are {', '.join(keys)}"


def _place(parent: str, schema: Any) -> str:
    options = [option for option, known in SCHEMAS.get(parent, {}).items() if known is schema]
    if len(options) == 1:
        return f"{parent}={options[0]}"
    return parent or "the configuration"


def _not_an_option(overrides: Sequence[str], options: Callable[[str], list[str]]) -> str | None:
    """A sentence for a group that was given something else than the name of an option."""
    for override in overrides:
        group, equals, value = override.partition("=")
        if equals and group == EXPERIMENT:
            return f"experiment is added with a plus: write +experiment={value}"
        if equals and group in SCHEMAS and value not in options(group):
            sweep = "; several options need --multirun" if "," in value else ""
            return f"{group} must be one of {', '.join(options(group))}, got {value!r}{sweep}"
    return None
