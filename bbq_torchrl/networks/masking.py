"""Values of actions that are not legal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["masked"]


def masked(values: Tensor, mask: Tensor | None) -> Tensor:
    """Returns values [*batch, N] with the least number at what is not legal, as TorchRL has it.

    Args:
        values: of all actions.
        mask: bool [*batch, N], True for legal actions; None if all are.
    """
    if mask is None:
        return values
    return torch.where(mask, values, torch.finfo(values.dtype).min)
