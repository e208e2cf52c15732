"""Errors that stop training or prevent resuming it."""

from __future__ import annotations

from pathlib import Path

from torch import nn


class TrainingError(ValueError):
    """An error that stops training or prevents resuming it; its message is for the user."""


class SpikeError(TrainingError):
    """Spiked transitions that do not fit the replay buffer."""


class CheckpointDamagedError(TrainingError):
    """A run has no usable checkpoint, though it had one."""

    @classmethod
    def gone(cls, run_folder: Path) -> CheckpointDamagedError:
        """Returns the error for a started run without a checkpoint."""
        return cls(
            f"{run_folder} has metrics or a result, but no checkpoint to resume from: restore its "
            "checkpoint/, resume a copy of the folder that has it, or start a new run"
        )


class CheckpointMismatchError(TrainingError):
    """A checkpoint has another seed or configuration."""


class RunFolderGoneError(TrainingError):
    """A run folder was moved or removed during the run."""

    @classmethod
    def check(cls, run_folder: Path) -> None:
        """Raises the error if the folder no longer exists.

        Raises:
            RunFolderGoneError: if the folder no longer exists.
        """
        if not run_folder.is_dir():
            raise cls(
                f"{run_folder} was moved or removed during the run: "
                "resume=<its new path> continues from its last checkpoint"
            )


class NonFiniteWeightsError(TrainingError):
    """A policy's weights are NaN or infinite."""

    @classmethod
    def check(cls, policy: nn.Module, where: object) -> None:
        """Raises the error if a policy has NaN or infinite weights.

        Args:
            policy: the policy.
            where: the origin of the weights in the message, such as a folder.

        Raises:
            NonFiniteWeightsError: if a weight is NaN or infinite.
        """
        for name, weight in policy.named_parameters():
            if not bool(weight.isfinite().all()):
                raise cls(
                    f"{where} has weights that are NaN or infinite ({name}), so the agent cannot "
                    "act: train again, with a smaller agent.lr if training diverged"
                )


class NonFiniteLossError(TrainingError):
    """A replica's loss became NaN or infinite; the training state has been saved."""
