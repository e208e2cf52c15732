"""Keys with lists: different values of a hyper-parameter in the replicas of a run."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Protocol

from bbq_torchrl.options.settings import ConfigError, Values, walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from torch import Tensor

    from bbq_torchrl.options.registry import Option
    from bbq_torchrl.options.task import Task


class Replicated(Protocol):
    """A configuration with replicas."""

    replicas: int


def spread(value: Any, replicas: int) -> list[Any]:
    """Returns the value of each replica; neighboring replicas share the values of a shorter list.

    Args:
        value: one value, or a list whose length divides ``replicas``.
        replicas: the number of replicas.

    Examples:
        >>> spread([0.1, 0.2], 6)
        [0.1, 0.1, 0.1, 0.2, 0.2, 0.2]
        >>> spread(0.1, 2)
        [0.1, 0.1]
    """
    values = value if isinstance(value, list) else [value]
    times = replicas // len(values)
    return [item for item in values for _ in range(times)]


def replica_values(config: Replicated) -> list[dict[str, float]]:
    """Returns, for each replica, its values of the keys with lists, by dotted key."""
    columns = {key: spread(value, config.replicas) for key, value in lists(config)}
    return [
        {key: float(values[replica]) for key, values in columns.items()}
        for replica in range(config.replicas)
    ]


def lists(config: Replicated) -> Iterator[tuple[str, list[Any]]]:
    """Yields (dotted key, values) of the keys whose values differ between replicas."""
    for key, item, value in walk(config):
        if isinstance(value, list) and item.metadata["allowed"].per_replica:
            yield key, value


def check_falls(option: Option, first: str, last: str) -> None:
    """Refuses a schedule, given by two keys of an option, that rises for any replica."""
    start, end = getattr(option, first), getattr(option, last)
    # All numbers of replicas that both lengths divide give the same pairs.
    replicas = math.lcm(*(len(value) if isinstance(value, list) else 1 for value in (start, end)))
    pairs = zip(spread(start, replicas), spread(end, replicas), strict=True)
    if any(before < after for before, after in pairs):
        group = option.group
        raise ConfigError(f"{group}.{first} must be at least {group}.{last} ({end}), got {start}")


def over_replicas(value: Values, task: Task) -> float | Tensor:
    """Returns a number as a float, and a list as a float64 tensor [replicas]."""
    if isinstance(value, list):
        import torch

        return torch.tensor(spread(value, task.replicas), dtype=torch.float64)
    return float(value)


def beside_dialogues(value: Values, task: Task) -> float | Tensor:
    """Returns a number as a float, and a list as a float64 tensor [replicas, 1]."""
    over = over_replicas(value, task)
    return over if isinstance(over, float) else over.unsqueeze(-1)


def annealed_rounds(fraction: float, task: Task) -> int:
    """Returns the length of a schedule in rounds, at least 1."""
    return max(1, round(fraction * task.rounds))


def keys_with_lists(schemas: Mapping[str, Mapping[str, type]]) -> list[str]:
    """Returns the distinct dotted keys that can have a list.

    Args:
        schemas: group -> name -> option.
    """
    found = {
        f"{group}.{item.name}": None
        for group, options in schemas.items()
        for schema in options.values()
        for item in fields(schema)
        if item.metadata["allowed"].per_replica
    }
    return list(found)
