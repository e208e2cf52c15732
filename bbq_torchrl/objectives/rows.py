"""The rows of a batch that count, and their weights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torch import Tensor
    from torchrl.objectives import LossModule


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

    Where that is "auto", rows must count by "valid" (which the trainer's batches have) and by the
    entries that TorchRL reads by default.

    Args:
        loss: whose key it is.
        tensordict: a batch.
        rows: the batch's shape.

    Raises:
        ValueError: for a mask of another shape.
    """
    counts: Tensor | None = None
    own = ("valid",) if loss.loss_mask_key == "auto" else ()
    for key in (*own, *loss._loss_mask_keys()):
        mask = row_entry(tensordict, key, rows)
        if mask is not None:
            counts = mask.bool() if counts is None else counts & mask.bool()
    return counts


def weights_of_rows(
    loss: LossModule, tensordict: TensorDictBase, rows: torch.Size
) -> Tensor | None:
    """Returns the weight of each row, [*rows, 1]; None if all rows count the same.

    Floating-point where prioritized replay gave the rows weights, else bool.

    Args:
        loss: whose keys for masks and for the weights of prioritized replay are read.
        tensordict: a batch.
        rows: the batch's shape.

    Raises:
        ValueError: for a mask or weights of another shape.
    """
    counts = rows_that_count(loss, tensordict, rows)
    if loss.use_prioritized_weights not in (True, "auto"):
        return counts
    priority = row_entry(tensordict, loss.tensor_keys.priority_weight, rows)
    if priority is None or counts is None:
        return counts if priority is None else priority
    return priority.where(counts, 0)


def row_weights(loss: LossModule, tensordict: TensorDictBase, reward: Tensor) -> Tensor | None:
    """Returns weights [*replicas, *batch, 1] that add up to 1; None if all rows count the same.

    Args:
        loss: with ``replicas``, and the keys of masks and of prioritized weights.
        tensordict: a batch.
        reward: shape [*replicas, *batch, 1].

    Raises:
        ValueError: for a mask or weights of another shape.
    """
    weight = weights_of_rows(loss, tensordict, reward.shape[:-1])
    if weight is None:
        return None
    weight = weight.to(torch.result_type(reward, 1.0))  # rewards may be whole numbers
    # 0 / tiny where no row counts at all: such a replica's data have no gradient
    tiny = torch.finfo(weight.dtype).tiny
    total = weight.sum(tuple(range(len(loss.replicas), reward.ndim)), keepdim=True)
    return weight / total.clamp_min_(tiny)
