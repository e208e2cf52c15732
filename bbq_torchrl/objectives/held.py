"""What a loss makes once an epoch and not for every batch."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from torch import Tensor, nn

from bbq_torchrl.bayes.noise_pool import noise_pool

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Holds"]


class Holds(nn.Module):
    """What losses with ``hold`` share: a pool of random numbers, new for every epoch.

    To be inherited from before TorchRL's ``LossModule``.

    Attributes:
        hold: whether anything is held.
    """

    hold: bool

    def _register_hold(self, hold: bool) -> None:
        self.hold = hold
        self._pool = noise_pool()

    def begin_epoch(self) -> None:
        """Has what is held made anew, where ``hold`` is set."""
        self._pool.clear()

    def _holds(self, tensors: Sequence[Tensor]) -> bool:
        """Whether anything is held for a network of these parameters: on a CPU only."""
        return self.hold and tensors[0].device.type == "cpu"

    def _random_numbers(self, tensors: Sequence[Tensor]) -> AbstractContextManager[Any]:
        """Returns the context that a batch's noise and dropout are drawn in."""
        return self._pool if self._holds(tensors) else nullcontext()

    def __getstate__(self) -> dict[str, Any]:
        state: dict[str, Any] = super().__getstate__()
        return {**state, "_pool": noise_pool()}
