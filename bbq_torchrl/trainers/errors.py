"""What stops a training."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["NonFiniteLossError", "SpikeError"]


class SpikeError(ValueError):
    """Spiked transitions that do not fit the replay buffer."""


class NonFiniteLossError(RuntimeError):
    """A replica's loss became NaN or infinite.

    Args:
        round_number (int): the round in which it happened.
        replicas (sequence of int): the replicas whose loss is not finite.
        saved (Path): where the state of the training was saved for inspection.

    Example:
        >>> from pathlib import Path
        >>> raise NonFiniteLossError(7, [1], Path("run/checkpoint/failed.torchrl"))
        Traceback (most recent call last):
        bbq_torchrl.trainers.errors.NonFiniteLossError: the loss of replica 1 is not finite in
        round 7; the state is saved in run/checkpoint/failed.torchrl
    """

    def __init__(self, round_number: int, replicas: Sequence[int], saved: Path) -> None:
        self.round_number = round_number
        self.replicas = tuple(replicas)
        self.saved = saved
        names = ", ".join(str(replica) for replica in replicas)
        noun = "replica" if len(self.replicas) == 1 else "replicas"
        super().__init__(
            f"the loss of {noun} {names} is not finite in round {round_number}; "
            f"the state is saved in {saved}"
        )
