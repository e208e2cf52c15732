"""Replicas, independent networks side by side: their shape, and a value for each of them."""

from __future__ import annotations

from operator import index
from typing import TYPE_CHECKING, SupportsIndex

import torch
from torch import Tensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn

__all__ = ["replica_shape", "replica_values", "replicas_of"]


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


def replica_values(
    name: str,
    values: Tensor,
    replicas: Sequence[int],
    *,
    minimum: float | None = None,
    maximum: float | None = None,
) -> Tensor:
    """Returns a hyper-parameter's checked values, float64 [*replicas].

    In float64, so that what is computed from them rounds as it does from one Python number.

    Args:
        name: of the hyper-parameter, for the message.
        values: one for each, shape [*replicas].
        replicas: the shape.

    Keyword Args:
        minimum: the least value that is allowed. Defaults to None: any above 0.
        maximum: the greatest. Defaults to None: any finite one.

    Raises:
        ValueError: for another shape, or a value that is not allowed.

    Examples:
        >>> replica_values("noise_std", torch.tensor([1, 2]), (2,))
        tensor([1., 2.], dtype=torch.float64)
    """
    if values.shape != torch.Size(replicas):
        raise ValueError(
            f"{name} must be one number or have the replicas' shape {list(replicas)}, got "
            f"{list(values.shape)}"
        )
    values = values.detach().double()
    fits = values > 0 if minimum is None else values >= minimum
    fits &= values.isfinite() if maximum is None else values <= maximum
    if not bool(fits.all()):
        allowed = "positive" if minimum is None else f"at least {minimum:g}"
        allowed += " and finite" if maximum is None else f" and at most {maximum:g}"
        raise ValueError(f"{name} must be {allowed}, got {values.tolist()}")
    return values


def replicas_of(network: nn.Module) -> torch.Size:
    """Returns the replica dimension that the layers of a network have in common, () if none.

    Raises:
        ValueError: if they differ.
    """
    found = (getattr(module, "replicas", None) for module in network.modules())
    shapes = {shape for shape in found if isinstance(shape, torch.Size)}
    if len(shapes) > 1:
        raise ValueError(
            f"the network's layers must have one replica dimension in common, got {shapes}"
        )
    return shapes.pop() if shapes else torch.Size(())
