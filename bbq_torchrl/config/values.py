"""Keys with a list: several values of a hyper-parameter along the replicas of one run."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from bbq_torchrl.config.settings import ConfigError, walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from bbq_torchrl.config.schema import Config

__all__ = ["check_values", "keys_with_lists", "replica_values", "spread"]


def spread(value: Any, replicas: int) -> list[Any]:
    """Returns what each replica has: neighbours share a value where there are fewer than replicas.

    Args:
        value: one value, or a list whose length divides ``replicas``.
        replicas: how many there are.

    Example:
        >>> spread([0.1, 0.2], 6)
        [0.1, 0.1, 0.1, 0.2, 0.2, 0.2]
        >>> spread(0.1, 2)
        [0.1, 0.1]
    """
    values = value if isinstance(value, list) else [value]
    times = replicas // len(values)
    return [item for item in values for _ in range(times)]


def replica_values(config: Config) -> list[dict[str, float]]:
    """Returns for each replica the values of the keys that have a list: dotted key to value."""
    columns = {key: spread(value, config.replicas) for key, value in _lists(config)}
    return [
        {key: float(values[replica]) for key, values in columns.items()}
        for replica in range(config.replicas)
    ]


def check_values(config: Config) -> None:
    """Checks that the replicas can share out the values of each list.

    Raises:
        ConfigError: naming the first key whose list has another length, or the schedule that a
            pair of values is not.
    """
    for key, value in _lists(config):
        if config.replicas % len(value):
            raise ConfigError(
                f"{key} must be one value or a list of {config.replicas} (one for each of the "
                f"replicas) or of a number that divides {config.replicas}, got {len(value)}: "
                f"{value}"
            )
    for name in ("eps", "temperature"):
        start = getattr(config.explore, f"{name}_init", None)
        end = getattr(config.explore, f"{name}_end", None)
        pairs = zip(spread(start, config.replicas), spread(end, config.replicas), strict=True)
        if start is not None and any(first < last for first, last in pairs):
            raise ConfigError(
                f"explore.{name}_init must be at least explore.{name}_end ({end}), got {start}"
            )


def keys_with_lists(schemas: Mapping[str, Mapping[str, type]]) -> dict[str, list[str]]:
    """Returns the dotted keys that can have a list, each with the options that have the key.

    Args:
        schemas: group to option to its dataclass.
    """
    found: dict[str, list[str]] = {}
    for group, options in schemas.items():
        for option, schema in options.items():
            for item in fields(schema):
                if item.metadata["allowed"].per_replica:
                    found.setdefault(f"{group}.{item.name}", []).append(option)
    return found


def _lists(config: Config) -> Iterator[tuple[str, list[Any]]]:
    for key, item, value in walk(config):
        if isinstance(value, list) and item.metadata["allowed"].per_replica:
            yield key, value
