"""Checks of what an environment is given: batch size, device, actions."""

from __future__ import annotations

from operator import index
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


def checked_batch(batch_size: Sequence[int]) -> torch.Size:
    """Returns the batch size.

    Raises:
        ValueError: if it is no sequence of positive integers.
    """
    try:
        shape = torch.Size([index(size) for size in batch_size])
    except TypeError:
        shape = torch.Size([0])
    if any(size < 1 for size in shape):
        raise ValueError(
            f"batch_size must be a sequence of numbers above 0, such as (50,), got {batch_size}"
        )
    return shape


def present_device(device: torch.device | str) -> torch.device:
    """Returns the device.

    Raises:
        ValueError: if it is absent.
    """
    try:
        return torch.empty(0, device=device).device
    except (AssertionError, RuntimeError) as error:
        raise ValueError(
            f"device must be one that is present, got {str(device)!r}: {error}"
        ) from error
