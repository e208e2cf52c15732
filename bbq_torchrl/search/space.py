"""The space of a key: a range of numbers or a list of choices."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from bbq_torchrl.settings import (
    BOOLEAN,
    REQUIRED,
    Allowed,
    ConfigError,
    filled,
    integers,
    one_of,
    optional,
    setting,
)
from bbq_torchrl.utils.text import shown

NUMBER = Allowed(
    "a number",
    lambda value: type(value) in (int, float) and math.isfinite(value),
)
INTEGER = Allowed("an integer", integers(-(10**9)).test)
CHOICES = Allowed(
    "a list of values, at least one",
    lambda value: (
        isinstance(value, list)
        and bool(value)
        and all(isinstance(item, (bool, int, float, str, type(None))) for item in value)
    ),
)


@dataclass
class Range:
    """Numbers from ``low`` to ``high``."""

    type: str = setting("float", one_of("float"), "type of the values")
    low: float = setting(REQUIRED, NUMBER, "least value")
    high: float = setting(REQUIRED, NUMBER, "greatest value")
    log: bool = setting(False, BOOLEAN, "whether values are drawn evenly on a logarithmic scale")
    step: float | None = setting(None, optional(NUMBER, "any value"), "distance between values")

    @property
    def probes(self) -> list[Any]:
        """The bounds."""
        return [self.low, self.high]


@dataclass
class IntegerRange(Range):
    """Integers from ``low`` to ``high``."""

    type: str = setting("int", one_of("int"), "type of the values")
    low: int = setting(REQUIRED, INTEGER, "least value")
    high: int = setting(REQUIRED, INTEGER, "greatest value")
    step: int | None = setting(None, optional(INTEGER, "any value"), "distance between values")


@dataclass
class Choices:
    """A list of values."""

    type: str = setting("categorical", one_of("categorical"), "type of the values")
    choices: list[Any] = setting(REQUIRED, CHOICES, "the values")

    @property
    def probes(self) -> list[Any]:
        """All values."""
        return self.choices


Parameter = Range | Choices
KINDS = {"float": Range, "int": IntegerRange, "categorical": Choices}


def parse_parameter(key: str, plain: Any) -> Parameter:
    """Reads an entry such as ``{type: float, low: 0.01, high: 1.0, log: true}``.

    Args:
        key: ``search.space.<key of train.py>``, for messages.
        plain: the entry.

    Raises:
        ConfigError: an invalid entry.

    Examples:
        >>> entry = {"type": "float", "low": 1e-4, "high": 0.01, "log": True}
        >>> parse_parameter("search.space.agent.lr", entry).probes
        [0.0001, 0.01]
    """
    if not isinstance(plain, Mapping):
        raise ConfigError(
            f"{key} must be a mapping such as {{type: float, low: 0, high: 1}}, got {shown(plain)}"
        )
    given = {str(name): value for name, value in plain.items()}
    kind = given.get("type")
    if kind not in KINDS:
        raise ConfigError(f"{key}.type must be one of {', '.join(KINDS)}, got {shown(kind)}")
    parameter: Parameter = filled(KINDS[kind], given, f"{key}.")
    if isinstance(parameter, Range):
        low, high, step = parameter.low, parameter.high, parameter.step
        if low >= high:
            raise ConfigError(f"{key}.low must be below {key}.high ({high}), got {low}")
        if parameter.log and low <= 0:
            raise ConfigError(f"{key}.low must be positive with log=true, got {low}")
        if step is not None and (parameter.log or step <= 0):
            raise ConfigError(f"{key}.step must be positive, and goes without log, got {step}")
    return parameter


def as_entry(parameter: Parameter) -> dict[str, Any]:
    """Returns a parameter as an entry of a YAML file."""
    return {key: value for key, value in asdict(parameter).items() if value is not None}
