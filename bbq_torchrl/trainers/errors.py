"""What stops a training, or keeps one from going on."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = [
    "CheckpointDamagedError",
    "CheckpointMismatchError",
    "NonFiniteLossError",
    "SpikeError",
    "TrainingError",
]


class TrainingError(ValueError):
    """What stops a training, or keeps one from going on; its text is enough for a person."""


class SpikeError(TrainingError):
    """Spiked transitions that do not fit the replay buffer."""


class CheckpointDamagedError(TrainingError):
    """No checkpoint of a run can be used, though there was one."""

    @classmethod
    def gone(cls, run_folder: Path) -> CheckpointDamagedError:
        """Returns the error of a run that has begun and has no checkpoint any more."""
        return cls(
            f"{run_folder} has metrics or a result, but no checkpoint to go on from: put its "
            "checkpoint/ back, resume a copy of the folder that has it, or start a new run"
        )


class CheckpointMismatchError(TrainingError):
    """A checkpoint is one of another seed or configuration."""


class NonFiniteLossError(TrainingError):
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
