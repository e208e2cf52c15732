"""What modules of a policy may have besides ``forward``, and when the trainer calls it."""

from __future__ import annotations

from typing import Protocol


class Resampled(Protocol):
    """A module that keeps something for a round, such as a draw of weights. Others keep nothing."""

    def resample(self) -> None:
        """Draws anew; called before the episodes of a round are played."""


class Annealed(Protocol):
    """A module with a schedule, as TorchRL's ``EGreedyModule`` has it. Others stay as they are."""

    def step(self, frames: int = 1, /) -> None:
        """Moves the schedule on; called after each round, with 1."""
