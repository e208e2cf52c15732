"""Keys with a list: several values of a hyper-parameter in the replicas of one run."""

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
    """A configuration of independent seeds that are trained together."""

    replicas: int


def spread(value: Any, replicas: int) -> list[Any]:
    """Returns the value of each replica: neighbors share one where there are fewer than replicas.

    Args:
        value: one value, or a list whose length divides ``replicas``.
        replicas: their number.

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
    """Returns for each replica the values of the keys that have a list: dotted key to value."""
    columns = {key: spread(value, config.replicas) for key, value in lists(config)}
    return [
        {key: float(values[replica]) for key, values in columns.items()}
        for replica in range(config.replicas)
    ]


def lists(config: Replicated) -> Iterator[tuple[str, list[Any]]]:
    """Yields the keys whose values differ between replicas: dotted key, and the values."""
    for key, item, value in walk(config):
        if isinstance(value, list) and item.metadata["allowed"].per_replica:
            yield key, value


def check_falls(option: Option, first: str, last: str) -> None:
    """Refuses a schedule that rises for any replica, from one key of an option to another."""
    start, end = getattr(option, first), getattr(option, last)
    # Any number of replicas that both lists divide has the same pairs.
    replicas = math.lcm(*(len(value) if isinstance(value, list) else 1 for value in (start, end)))
    pairs = zip(spread(start, replicas), spread(end, replicas), strict=True)
    if any(before < after for before, after in pairs):
        group = option.group
        raise ConfigError(f"{group}.{first} must be at least {group}.{last} ({end}), got {start}")


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
    """Returns the length of a schedule; a share of 0 ends after the first round."""
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
