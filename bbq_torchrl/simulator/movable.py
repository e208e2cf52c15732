"""What holds tensors, and is wanted on another device."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Movable"]


class Movable:
    """An object whose tensors are its attributes."""

    def to(self, device: torch.device | str) -> Self:
        """Returns the same object with every tensor on ``device``."""
        moved = copy(self)
        moved._move(device)
        return moved

    def _move(self, device: torch.device | str) -> None:
        for name, value in vars(self).items():
            if isinstance(value, torch.Tensor):
                setattr(self, name, value.to(device))
