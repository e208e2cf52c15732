"""Replicas, independent networks side by side: their shape."""

from __future__ import annotations

from operator import index
from typing import TYPE_CHECKING, SupportsIndex

import torch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn


def replica_shape(replicas: SupportsIndex | Sequence[int]) -> torch.Size:
    """Returns the leading shape that replicas give to weights and data: 5 is (5,).

    Raises:
        ValueError: if a number is not positive.

    Examples:
        >>> replica_shape(5), replica_shape((2, 3)), replica_shape(())
        (torch.Size([5]), torch.Size([2, 3]), torch.Size([]))
    """
    shape = (index(replicas),) if isinstance(replicas, SupportsIndex) else tuple(replicas)
    if any(size < 1 for size in shape):
        raise ValueError(f"replicas must be positive, got {replicas}")
    return torch.Size(shape)


def replicas_of(network: nn.Module) -> torch.Size:
    """Returns the replica dimension that the layers of a network have in common, () if none.

    Those that have one say so by an attribute ``replicas``: a shape, or a number.

    Raises:
        ValueError: if they differ, or one is neither.

    Examples:
        >>> network = torch.nn.Identity()
        >>> network.replicas = 5
        >>> replicas_of(torch.nn.Sequential(network, torch.nn.ReLU()))
        torch.Size([5])
    """
    shapes = set()
    for module in network.modules():
        found = getattr(module, "replicas", None)
        if found is None or callable(found):  # a module or method of that name says something else
            continue
        sizes = found if isinstance(found, (tuple, list)) else (found,)
        if not all(isinstance(size, int) for size in sizes):
            raise ValueError(
                f"a network's replicas must be an integer or a tuple of integers, got {found!r}"
            )
        shapes.add(replica_shape(sizes))
    if len(shapes) > 1:
        raise ValueError(
            f"the network's layers must have one replica dimension in common, got {shapes}"
        )
    return shapes.pop() if shapes else torch.Size(())
