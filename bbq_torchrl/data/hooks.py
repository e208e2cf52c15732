"""What a module of a replay's transform may have besides TorchRL's methods, and who calls it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor


class Seeded(Protocol):
    """A transform with random numbers of its own. Others draw none, or from torch's generator."""

    def set_seeds(self, seeds: Sequence[int], /) -> None:
        """Seeds each replica's; called by the replay along with its shuffling."""


class Measured(Protocol):
    """A transform that notes something worth a metric. Others add none."""

    def pop_metrics(self) -> Mapping[str, Tensor]:
        """Returns metrics by name, each [replicas], of what was stored since the last call."""
