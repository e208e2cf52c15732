"""The rows of a batch that count, their weights, and the number of all data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from collections.abc import Mapping

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


class NumData(nn.Module):
    """The N of losses with a KL / N: a buffer, one for each replica.

    To be inherited from before TorchRL's ``LossModule``.
    """

    num_data: Tensor
    replicas: torch.Size

    def _register_num_data(self, num_data: int | Tensor | None, like: Tensor) -> None:
        """Makes the buffer, [*replicas], with the dtype and device of ``like``."""
        # 0 stands for "not known yet"
        self.register_buffer("num_data", like.new_zeros(self.replicas))
        self._num_data_known = False
        if num_data is not None:
            self.set_num_data(num_data)

    def set_num_data(self, num_data: int | Tensor) -> None:
        """Sets N, the number of transitions that the KL is spread over.

        Args:
            num_data: a number, or one for each replica, [*replicas]; positive (tensors
                are not checked, so that no device has to be waited for).

        Raises:
            ValueError: if a number is not positive or a tensor's shape does not fit.
        """
        if isinstance(num_data, torch.Tensor):
            if num_data.shape not in (self.replicas, torch.Size(())):
                raise ValueError(
                    f"num_data must be a number or have shape {list(self.replicas)}, got "
                    f"{list(num_data.shape)}"
                )
            self.num_data.copy_(num_data)
        else:
            if not num_data > 0:
                raise ValueError(f"num_data must be positive, got {num_data}")
            self.num_data.fill_(num_data)
        self._num_data_known = True

    def _check_num_data(self) -> None:
        """Raises RuntimeError unless N is known."""
        if not self._num_data_known:
            raise RuntimeError(
                f"num_data is not known: give it to {type(self).__name__} or call "
                "set_num_data(n) with the number of transitions in the buffer"
            )

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)
        loaded = state_dict.get(prefix + "num_data")
        if loaded is not None:
            self._num_data_known = bool((loaded > 0).all())
