"""Replicas (independent networks in one module): their shape, and settings per replica."""

from __future__ import annotations

from collections.abc import Sequence
from operator import index
from typing import SupportsIndex

import torch
from torch import Tensor, nn

from bbq_torchrl.settings import ABOVE_ZERO, Allowed


def replica_shape(replicas: SupportsIndex | Sequence[int]) -> torch.Size:
    """Returns the leading shape of weights and data for a number or shape of replicas.

    Examples:
        >>> replica_shape(5), replica_shape((2, 3)), replica_shape(())
        (torch.Size([5]), torch.Size([2, 3]), torch.Size([]))
    """
    return torch.Size([index(replicas)] if isinstance(replicas, SupportsIndex) else replicas)


def replicas_of(network: nn.Module) -> torch.Size:
    """Returns the replica shape that the layers of a network share, () if no layer has one.

    A layer's replica shape is its attribute ``replicas``, a shape or a number.

    Raises:
        ValueError: if layers differ.

    Examples:
        >>> network = torch.nn.Identity()
        >>> network.replicas = 5
        >>> replicas_of(torch.nn.Sequential(network, torch.nn.ReLU()))
        torch.Size([5])
    """
    shapes = set()
    for module in network.modules():
        found = getattr(module, "replicas", None)
        if found is None or callable(found):  # a module or method of that name is unrelated
            continue
        shapes.add(replica_shape(found))
    if len(shapes) > 1:
        raise ValueError(f"the network's layers must share one replica shape, got {shapes}")
    return shapes.pop() if shapes else torch.Size(())


def checked_number(
    name: str,
    value: float | Tensor,
    replicas: Sequence[int] = (),
    allowed: Allowed = ABOVE_ZERO,
) -> float | Tensor:
    """Returns a checked number, or checked numbers per replica as float64 [*replicas].

    The dtype is float64 so that results round as they do with one Python number.

    Args:
        name: the setting's name in the error message.
        value: a number, a tensor or list [*replicas], or a tensor [].
        replicas: the replica shape.
        allowed: the allowed numbers.

    Raises:
        ValueError: for a wrong shape or a value that is not allowed.

    Examples:
        >>> checked_number("noise_std", 1.0), checked_number("eta", torch.tensor([1, 2]), (2,))
        (1.0, tensor([1., 2.], dtype=torch.float64))
    """
    if not isinstance(value, (int, float)):
        value = torch.as_tensor(value, dtype=torch.float64).detach()
        if value.shape not in (torch.Size(replicas), torch.Size()):
            raise ValueError(
                f"{name} must be one number or have the replicas' shape {list(replicas)}, got "
                f"{list(value.shape)}"
            )
    numbers = value.flatten().tolist() if isinstance(value, Tensor) else [value]
    if not all(map(allowed.test, numbers)):
        got = value.tolist() if isinstance(value, Tensor) else value
        raise ValueError(f"{name} must be {allowed.text}, got {got}")
    return value
