"""Values that fall by a schedule, one for each part of a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["check_batch", "schedule"]


def check_batch(name: str, values: Tensor, batch: torch.Size) -> None:
    """Raises ValueError unless values have a shape that broadcasts to the batch's."""
    missing = len(batch) - values.ndim
    fits = missing >= 0 and all(
        size in (1, rows) for size, rows in zip(values.shape, batch[missing:], strict=True)
    )
    if not fits:
        raise ValueError(
            f"{name} of shape {list(values.shape)} must broadcast with the batch, got {list(batch)}"
        )


def schedule(start: float | Tensor, end: float | Tensor) -> tuple[Tensor, Tensor]:
    """Returns both as float32 tensors of one shape, not those that were given."""
    pair = [torch.as_tensor(value, dtype=torch.float32) for value in (start, end)]
    first, last = (value.clone() for value in torch.broadcast_tensors(*pair))
    return first, last
