"""Weights of the rows of a batch: which count, and how much."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tensordict.utils import NestedKey
    from torch import Tensor

__all__ = ["normalized_weights"]


def normalized_weights(
    weight: Tensor | None, masks: Mapping[NestedKey, Tensor | None], like: Tensor, replicas: int
) -> Tensor | None:
    """Returns the product of all weights, adding up to 1 over each batch; None if there are none.

    Args:
        weight: [*replicas, *batch, 1], or None.
        masks: other weights, or bools, [*replicas, *batch] or [*replicas, *batch, 1], by the keys
            that an error names; None where there is none.
        like: what the weights are for, [*replicas, *batch, 1].
        replicas: how many dimensions the replicas are.

    Raises:
        ValueError: for a mask of another shape.
    """
    for key, mask in masks.items():
        if mask is not None:
            if mask.ndim == like.ndim - 1:
                mask = mask.unsqueeze(-1)
            if mask.shape != like.shape:
                raise ValueError(
                    f"{key!r} must have the batch's shape {list(like.shape[:-1])}, got "
                    f"{list(mask.shape)}"
                )
            mask = mask.to(like.dtype)
            weight = mask if weight is None else weight * mask
    if weight is None:
        return None
    # 0 / tiny where no row counts at all: such a replica's data have no gradient
    tiny = torch.finfo(weight.dtype).tiny
    total = weight.sum(tuple(range(replicas, like.ndim)), keepdim=True)
    return weight / total.clamp_min_(tiny)
