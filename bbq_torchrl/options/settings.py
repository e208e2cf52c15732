"""Configuration keys: default, allowed values and meaning, declared once.

::

    lr: float = setting(1e-3, STEP_SIZE, "learning rate of Adam")

OmegaConf checks the type, :func:`check_settings` the value. Both refuse in one sentence that names
the key, what is allowed and what was given. The bounds are those of :mod:`bbq_torchrl.checks`.
"""

from __future__ import annotations

from dataclasses import Field, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from bbq_torchrl.checks import (
    ABOVE_ZERO_TO_ONE as ABOVE_ZERO_TO_ONE,
    ANY_TEXT as ANY_TEXT,
    AT_LEAST_ZERO as AT_LEAST_ZERO,
    BATCH as BATCH,
    BELOW_ONE as BELOW_ONE,
    BOOLEAN as BOOLEAN,
    COUNT as COUNT,
    COUNTS as COUNTS,
    NON_NEGATIVE as NON_NEGATIVE,
    NON_NEGATIVE_INTEGER as NON_NEGATIVE_INTEGER,
    POSITIVE as POSITIVE,
    PROBABILITY as PROBABILITY,
    REWARD as REWARD,
    SEED as SEED,
    SIZE as SIZE,
    STEP_SIZE as STEP_SIZE,
    THREADS as THREADS,
    USERS as USERS,
    Allowed as Allowed,
    check as check,
    integers as integers,
    numbers as numbers,
    one_of as one_of,
    optional as optional,
    or_text as or_text,
    per_replica as per_replica,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    Values = float | list[float]
else:
    # OmegaConf has no union with a list, so the key's allowed values check the type.
    Values = Any

Schema = TypeVar("Schema")

REQUIRED = "???"
"""OmegaConf's mark of a required value."""


class ConfigError(ValueError):
    """An invalid configuration, explained in one sentence."""


def setting(default: Any, allowed: Allowed, meaning: str) -> Any:
    """A dataclass field with a default, the values it may take, and its meaning.

    Args:
        default: the default value; lists are copied for each instance.
        allowed: the values that :func:`check_settings` accepts.
        meaning: the key's meaning, with its unit.
    """
    metadata = {"allowed": allowed, "meaning": meaning}
    if isinstance(default, list):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


def other_default(base: type, key: str, default: Any) -> Any:
    """A base class's field with another default, the same allowed values and meaning."""
    return field(default=default, metadata=base.__dataclass_fields__[key].metadata)  # type: ignore[attr-defined]


def option(name: str) -> Any:
    """The field ``name`` of an option, which identifies it in its group."""
    return setting(name, one_of(name), "the option of the group; chosen by <group>=<option>")


def walk(config: Any, prefix: str = "") -> Iterator[tuple[str, Field[Any], Any]]:
    """Yields (dotted key, dataclass field, value) of every leaf of a configuration dataclass."""
    for item in fields(config):
        key = f"{prefix}{item.name}"
        value = getattr(config, item.name)
        if is_dataclass(value):
            yield from walk(value, f"{key}.")
        else:
            yield key, item, value


def check_settings(config: Any, prefix: str = "") -> None:
    """Checks every value of a configuration dataclass against what its field allows.

    Args:
        config: the dataclass.
        prefix: prefix of keys in messages.

    Raises:
        ConfigError: the value of a key is not allowed.

    Examples:
        >>> from dataclasses import dataclass
        >>> @dataclass
        ... class Optimizer:
        ...     lr: float = setting(1e-3, STEP_SIZE, "learning rate")
        >>> check_settings(Optimizer(lr=-1.0))
        Traceback (most recent call last):
        ...
        bbq_torchrl.options.settings.ConfigError: lr must be a number from 1e-30 to 1e30, got -1.0
    """
    for key, item, value in walk(config, prefix):
        allowed: Allowed = item.metadata["allowed"]
        if value == REQUIRED:
            raise ConfigError(f"{key} must be given: it must be {allowed.text}")
        check(key, value, allowed, ConfigError)


def filled(schema: type[Schema], given: Mapping[str, Any], prefix: str) -> Schema:
    """Returns a checked dataclass of settings with the given values.

    Args:
        schema: the dataclass.
        given: values by key.
        prefix: prefix of keys in messages.

    Raises:
        ConfigError: a key is unknown, or its value is not allowed.
    """
    known = list(schema.__dataclass_fields__)  # type: ignore[attr-defined]
    for key in given:
        if key not in known:
            raise ConfigError(f"{prefix}{key} is not a key; the keys are {', '.join(known)}")
    config = schema(**given)
    check_settings(config, prefix)
    return config
