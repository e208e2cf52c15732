"""Checks of actions, batch size and device, and the compiled turn."""

from __future__ import annotations

from operator import index
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDict
    from torch import Tensor

    from bbq_torchrl.simulator import Simulator


def action_indices(action: Tensor, batch_size: Sequence[int], count: int) -> Tensor:
    """Returns indices of actions, of any integer dtype, as int64, shape [*batch].

    Args:
        action: the actions.
        batch_size: their expected shape.
        count: number of actions to choose from.

    Raises:
        ValueError: if shape or dtype differ, as for one-hot actions.

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
    """Raises ValueError if an index is out of range."""
    wrong = action[(action < 0) | (action >= count)]
    if wrong.numel():
        raise ValueError(f"action must be from 0 to {count - 1}, got {int(wrong[0])}")


def checked_batch(batch_size: Sequence[int]) -> torch.Size:
    """Returns the batch size.

    Raises:
        ValueError: if it is not a sequence of positive integers.
    """
    try:
        shape = torch.Size([index(size) for size in batch_size])
    except TypeError:
        shape = torch.Size([0])
    if any(size < 1 for size in shape):
        raise ValueError(
            f"batch_size must be a sequence of positive numbers, such as (50,), got {batch_size}"
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


class CompiledPlay:
    """A simulator's compiled turn; copies and other processes compile it again.

    Its numbers are the same, except for the rounding of floating-point ones: the features, which
    are ratios of small integers.
    """

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        # isolate_recompiles: otherwise all environments of a process share torch's limit of 8
        # programs. (Torch's overloads lack the keyword.)
        self._play = torch.compile(  # type: ignore[call-overload]
            simulator.play, fullgraph=True, dynamic=False, isolate_recompiles=True
        )

    def __call__(self, *state_and_action: Any) -> tuple[TensorDict, torch.Tensor]:
        """Plays one turn, as :meth:`~bbq_torchrl.simulator.Simulator.play`."""
        return self._play(*state_and_action)

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledPlay, (self._simulator,)
