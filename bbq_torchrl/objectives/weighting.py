"""Weights of a batch's rows, and the number of data N, which weighs the KL."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.objectives import LossModule


def row_entry(tensordict: TensorDictBase, key: NestedKey, rows: torch.Size) -> Tensor | None:
    """Returns an entry with one value per row as [*rows, 1]; None if it is missing.

    Args:
        tensordict: a batch.
        key: the key of the entry, [*rows] or [*rows, 1].
        rows: the batch shape.

    Raises:
        ValueError: for an entry of the wrong shape.
    """
    entry: Tensor | None = tensordict.get(key, None)
    if entry is None or entry.shape == (*rows, 1):
        return entry
    if entry.shape != rows:
        raise ValueError(f"{key!r} must have the batch shape {list(rows)}, got {list(entry.shape)}")
    return entry.unsqueeze(-1)


def valid_rows(loss: LossModule, tensordict: TensorDictBase, rows: torch.Size) -> Tensor | None:
    """Returns the mask of rows that a loss learns from, bool [*rows, 1]; None for all rows.

    The loss's ``loss_mask_key`` names the mask. If it is "auto", the mask combines "valid" (which
    the trainer's batches have) with the entries that TorchRL reads by default.

    Args:
        loss: the loss with the key.
        tensordict: a batch.
        rows: the batch shape.

    Raises:
        ValueError: for a mask of the wrong shape.
    """
    valid: Tensor | None = None
    ours = ("valid",) if loss.loss_mask_key == "auto" else ()
    for key in (*ours, *loss._loss_mask_keys()):
        mask = row_entry(tensordict, key, rows)
        if mask is not None:
            valid = mask.bool() if valid is None else valid & mask.bool()
    return valid


def row_weights(loss: LossModule, tensordict: TensorDictBase, rows: torch.Size) -> Tensor | None:
    """Returns the weight of each row, [*rows, 1]; None if all rows weigh the same.

    Weights are floating-point if prioritized replay has set any, otherwise bool.

    Args:
        loss: the loss with the keys of masks and prioritized weights.
        tensordict: a batch.
        rows: the batch shape.

    Raises:
        ValueError: for a mask or weights of the wrong shape.
    """
    valid = valid_rows(loss, tensordict, rows)
    if loss.use_prioritized_weights not in (True, "auto"):
        return valid
    priority = row_entry(tensordict, loss.tensor_keys.priority_weight, rows)
    if priority is None or valid is None:
        return valid if priority is None else priority
    return priority.where(valid, 0)


def normalized_weights(
    loss: LossModule, tensordict: TensorDictBase, reward: Tensor
) -> Tensor | None:
    """Returns weights [*replicas, *batch, 1] that sum to 1; None if all rows weigh the same.

    Args:
        loss: the loss with ``replicas`` and the keys of masks and prioritized weights.
        tensordict: a batch.
        reward: shape [*replicas, *batch, 1].

    Raises:
        ValueError: for a mask or weights of the wrong shape.
    """
    weight = row_weights(loss, tensordict, reward.shape[:-1])
    if weight is None:
        return None
    weight = weight.to(torch.result_type(reward, 1.0))  # rewards may be integers
    # 0 / tiny: the data of a replica without valid rows have no gradient
    tiny = torch.finfo(weight.dtype).tiny
    total = weight.sum(tuple(range(len(loss.replicas), reward.ndim)), keepdim=True)
    return weight / total.clamp_min_(tiny)


class NumData(nn.Module):
    """A mixin for losses with a KL / N: the buffer of N, [*replicas].

    List it before TorchRL's ``LossModule`` in the bases.
    """

    num_data: Tensor
    replicas: torch.Size

    def _register_num_data(self, num_data: int | Tensor | None, like: Tensor) -> None:
        """Registers the buffer, [*replicas], with the dtype and device of ``like``."""
        # 0 means unknown
        self.register_buffer("num_data", like.new_zeros(self.replicas))
        self._num_data_known = False
        if num_data is not None:
            self.set_num_data(num_data)

    def set_num_data(self, num_data: int | Tensor) -> None:
        """Sets N, the number of transitions that the KL is divided by.

        Args:
            num_data: a positive number or a tensor [*replicas].
        """
        self.num_data.copy_(torch.as_tensor(num_data))
        self._num_data_known = True

    def _check_num_data(self) -> None:
        """Raises RuntimeError if N is unknown."""
        if not self._num_data_known:
            raise RuntimeError(
                f"num_data is unknown: pass it to {type(self).__name__} or call "
                "set_num_data(n) with the number of transitions in the buffer"
            )

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)
        loaded = state_dict.get(prefix + "num_data")
        if loaded is not None:
            self._num_data_known = bool((loaded > 0).all())
