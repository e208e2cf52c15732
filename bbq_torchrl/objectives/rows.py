"""Which rows of a batch count."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch
    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.objectives import LossModule

__all__ = ["row_entry", "rows_that_count"]


def row_entry(tensordict: TensorDictBase, key: NestedKey, rows: torch.Size) -> Tensor | None:
    """Returns an entry with one value a row, in the shape [*rows, 1]; None where it is absent.

    Args:
        tensordict: a batch.
        key: of the entry, [*rows] or [*rows, 1].
        rows: the batch's shape.

    Raises:
        ValueError: for an entry of another shape.
    """
    entry: Tensor | None = tensordict.get(key, None)
    if entry is None or entry.shape == (*rows, 1):
        return entry
    if entry.shape != rows:
        raise ValueError(
            f"{key!r} must have the batch's shape {list(rows)}, got {list(entry.shape)}"
        )
    return entry.unsqueeze(-1)


def rows_that_count(
    loss: LossModule, tensordict: TensorDictBase, rows: torch.Size
) -> Tensor | None:
    """Returns which rows count for a loss by its ``loss_mask_key``, bool [*rows, 1]; None for all.

    Args:
        loss: whose key it is.
        tensordict: a batch.
        rows: the batch's shape.

    Raises:
        ValueError: for a mask of another shape.
    """
    counts: Tensor | None = None
    for key in loss._loss_mask_keys():
        mask = row_entry(tensordict, key, rows)
        if mask is not None:
            counts = mask.bool() if counts is None else counts & mask.bool()
    return counts
