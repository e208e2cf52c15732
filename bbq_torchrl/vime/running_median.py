"""A running median for each replica."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from collections.abc import Sequence


class RunningMedian(nn.Module):
    """The median of the medians of the last calls, each replica its own.

    A median neither depends on the order of the values nor on how many do not count, so that
    replicas stay independent to the bit. (Of an even number of values it is the lower one.)

    Args:
        replicas: leading shape.
        window: how many calls count, at least 1.
        like: a tensor of the wanted dtype and device.

    Attributes:
        medians: buffer [*replicas, window], the medians of the last calls, overwritten in turn.
        calls: int64 buffer [*replicas], how many calls had a value that counts.

    Examples:
        >>> import torch
        >>> median = RunningMedian((), 2, torch.zeros(1))
        >>> for values in ([1.0, 2.0, 9.0], [4.0], [5.0, 7.0]):
        ...     median.update(torch.tensor(values))
        tensor(2.)
        tensor(2.)
        tensor(4.)
    """

    medians: Tensor
    calls: Tensor

    def __init__(self, replicas: Sequence[int], window: int, like: Tensor) -> None:
        super().__init__()
        self.register_buffer("medians", like.new_zeros((*replicas, window)))
        self.register_buffer("calls", like.new_zeros(tuple(replicas), dtype=torch.int64))

    @torch.no_grad()
    def update(self, values: Tensor, counts: Tensor | None = None) -> Tensor:
        """Takes values in and returns the median of the last medians, [*replicas]; NaN without any.

        Args:
            values: shape [*replicas, n]; NaN does not count.
            counts: bool [*replicas, n], True for the values that count; None for all. A replica
                without one keeps what it has.
        """
        window = self.medians.shape[-1]
        if counts is not None:
            values = torch.where(counts, values, torch.nan)
        median = values.nanmedian(-1, keepdim=True).values
        calls = self.calls.unsqueeze(-1)
        places = torch.arange(window, device=values.device)
        is_new = ~median.isnan()
        here = is_new & (places == calls % window)
        self.medians.copy_(torch.where(here, median, self.medians))
        calls = calls + is_new
        self.calls.copy_(calls.squeeze(-1))
        return torch.where(places < calls, self.medians, torch.nan).nanmedian(-1).values
