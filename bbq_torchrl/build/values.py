"""Several values of a hyper-parameter as a tensor over the replicas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bbq_torchrl.config.values import spread

if TYPE_CHECKING:
    from bbq_torchrl.config.settings import Values

__all__ = ["over_replicas"]


def over_replicas(value: Values, replicas: int) -> float | Tensor:
    """Returns one number as it is, and a list as float64 [replicas].

    Example:
        >>> over_replicas([0.5, 2.0], 4)
        tensor([0.5000, 0.5000, 2.0000, 2.0000], dtype=torch.float64)
    """
    if isinstance(value, list):
        return torch.tensor(spread(value, replicas), dtype=torch.float64)
    return float(value)
