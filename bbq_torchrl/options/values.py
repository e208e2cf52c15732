"""Keys with a list: several values of a hyper-parameter along the replicas of one run."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from bbq_torchrl.options.settings import ConfigError, Values, walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from torch import Tensor

    from bbq_torchrl.options.root import Config
    from bbq_torchrl.options.task import Task


def spread(value: Any, replicas: int) -> list[Any]:
    """Returns what each replica has: neighbors share a value where there are fewer than replicas.

    Args:
        value: one value, or a list whose length divides ``replicas``.
        replicas: how many there are.

    Examples:
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
        ConfigError: naming the first key whose list has another length.
    """
    for key, value in _lists(config):
        if config.replicas % len(value):
            raise ConfigError(
                f"{key} must be one value or a list of {config.replicas} (one for each of the "
                f"replicas) or of a number that divides {config.replicas}, got {len(value)}: "
                f"{value}"
            )


def check_falls(config: Config, first: str, last: str) -> None:
    """Refuses a schedule that rises for any replica, from one key of ``explore`` to another."""
    start, end = getattr(config.explore, first), getattr(config.explore, last)
    pairs = zip(spread(start, config.replicas), spread(end, config.replicas), strict=True)
    if any(before < after for before, after in pairs):
        raise ConfigError(f"explore.{first} must be at least explore.{last} ({end}), got {start}")


def over_replicas(value: Values, task: Task) -> float | Tensor:
    """Returns one number as it is, and a list as float64 [replicas]."""
    if isinstance(value, list):
        import torch

        return torch.tensor(spread(value, task.replicas), dtype=torch.float64)
    return float(value)


def beside_dialogues(value: Values, task: Task) -> float | Tensor:
    """Returns one number as it is, and a list as float64 [replicas, 1]."""
    over = over_replicas(value, task)
    return over if isinstance(over, float) else over.unsqueeze(-1)


def annealed_rounds(fraction: float, task: Task) -> int:
    """Returns the length of a schedule; a share of 0 is over after the first round."""
    return max(1, round(fraction * task.rounds))


def keys_with_lists(schemas: Mapping[str, Mapping[str, type]]) -> list[str]:
    """Returns the dotted keys that can have a list, each once.

    Args:
        schemas: group to option to its dataclass.
    """
    found = {
        f"{group}.{item.name}": None
        for group, options in schemas.items()
        for schema in options.values()
        for item in fields(schema)
        if item.metadata["allowed"].per_replica
    }
    return list(found)


def _lists(config: Config) -> Iterator[tuple[str, list[Any]]]:
    for key, item, value in walk(config):
        if isinstance(value, list) and item.metadata["allowed"].per_replica:
            yield key, value
