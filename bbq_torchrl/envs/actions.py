"""Actions as an environment takes them: indices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor


def action_indices(action: Tensor, batch_size: Sequence[int], count: int) -> Tensor:
    """Returns indices of actions, of any integer dtype, as int64, shape [*batch].

    Args:
        action: what was chosen.
        batch_size: the shape that it must have.
        count: how many actions there are.

    Raises:
        ValueError: for another shape or dtype, such as one-hot actions.

    Examples:
        >>> action_indices(torch.tensor([3, 0], dtype=torch.int32), [2], 4)
        tensor([3, 0])
    """
    is_integer = not (action.is_floating_point() or action.is_complex())
    if not is_integer or action.dtype == torch.bool or action.shape != torch.Size(batch_size):
        raise ValueError(
            f"action must be Categorical: indices from 0 to {count - 1}, of an integer dtype and "
            f"shape {list(batch_size)}, got {action.dtype} of shape {list(action.shape)}"
        )
    return action.long()


def check_range(action: Tensor, count: int) -> None:
    """Raises ValueError for an index that is no action's."""
    wrong = action[(action < 0) | (action >= count)]
    if wrong.numel():
        raise ValueError(f"action must be from 0 to {count - 1}, got {int(wrong[0])}")
