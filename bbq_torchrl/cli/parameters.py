"""What one key of a search may be: a range of numbers, or a list of choices."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from bbq_torchrl.options.settings import ConfigError
from bbq_torchrl.text import shown

__all__ = ["Parameter", "parse_parameter"]

_FIELDS = {
    "float": ("low", "high", "log", "step"),
    "int": ("low", "high", "log", "step"),
    "categorical": ("choices",),
}


@dataclass(frozen=True)
class Parameter:
    """A key that varies.

    Attributes:
        name: the dotted key of ``train.py``.
        type: ``float``, ``int`` or ``categorical``.
        low: least value of a number.
        high: greatest value of a number.
        log: whether numbers are drawn evenly on a logarithmic scale.
        step: distance of the values a number may have; ``None`` for any.
        choices: the values of a categorical.
    """

    name: str
    type: str
    low: float | None = None
    high: float | None = None
    log: bool = False
    step: float | None = None
    choices: tuple[Any, ...] = ()

    def probes(self) -> tuple[Any, ...]:
        """The values between which all others lie: both bounds, or every choice."""
        return self.choices if self.type == "categorical" else (self.low, self.high)

    def plain(self) -> dict[str, Any]:
        """The entry of a YAML file that stands for this."""
        values = {key: value for key, value in asdict(self).items() if value not in (None, ())}
        del values["name"]
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}


def parse_parameter(key: str, plain: Any) -> Parameter:
    """Reads an entry such as ``{type: float, low: 0.01, high: 1.0, log: true}``.

    Args:
        key: ``search.space.<key of train.py>``, by which errors name it.
        plain: the entry.

    Raises:
        ConfigError: an entry that is no such mapping; names the key.

    Example:
        >>> entry = {"type": "float", "low": 1e-4, "high": 0.01, "log": True}
        >>> parse_parameter("search.space.agent.lr", entry).probes()
        (0.0001, 0.01)
    """
    if not isinstance(plain, Mapping):
        raise ConfigError(
            f"{key} must be a mapping such as {{type: float, low: 0, high: 1}}, got {shown(plain)}"
        )
    kind = plain.get("type")
    if kind not in _FIELDS:
        raise ConfigError(f"{key}.type must be one of {', '.join(_FIELDS)}, got {shown(kind)}")
    for entry in plain:
        if entry != "type" and entry not in _FIELDS[kind]:
            raise ConfigError(
                f"{key}.{entry} is not a key; a {kind} has type, {', '.join(_FIELDS[kind])}"
            )
    name = key.removeprefix("search.space.")
    if kind == "categorical":
        return Parameter(name, kind, choices=_choices(key, plain.get("choices")))
    low, high = (_number(f"{key}.{entry}", plain.get(entry), kind) for entry in ("low", "high"))
    if low >= high:
        raise ConfigError(f"{key}.low must be below {key}.high ({high}), got {low}")
    log = plain.get("log", False)
    if not isinstance(log, bool):
        raise ConfigError(f"{key}.log must be true or false, got {shown(log)}")
    if log and low <= 0:
        raise ConfigError(f"{key}.low must be positive with log=true, got {low}")
    step = plain.get("step")
    if step is not None:
        step = _number(f"{key}.step", step, kind)
        if log or step <= 0:
            raise ConfigError(f"{key}.step must be positive, and goes without log, got {step}")
    return Parameter(name, kind, low, high, log, step)


def _number(key: str, value: Any, kind: str) -> Any:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if kind == "int":
        if is_number and isinstance(value, int):
            return value
        raise ConfigError(f"{key} must be an integer, got {shown(value)}")
    if is_number and math.isfinite(value):
        return float(value)
    raise ConfigError(f"{key} must be a number, got {shown(value)}")


def _choices(key: str, value: Any) -> tuple[Any, ...]:
    scalar = (bool, int, float, str, type(None))
    if isinstance(value, list) and value and all(isinstance(item, scalar) for item in value):
        return tuple(value)
    raise ConfigError(f"{key}.choices must be a list of values, at least one, got {shown(value)}")
