"""Errors that stop a training, or keep one from being resumed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from torch import nn


class TrainingError(ValueError):
    """An error that stops a training, or keeps one from being resumed; its text is for people."""


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


class RunFolderGoneError(TrainingError):
    """A run folder was moved or removed while the run was at work in it."""

    @classmethod
    def check(cls, run_folder: Path) -> None:
        """Raises the error where there is no such folder any more.

        Raises:
            RunFolderGoneError: always then.
        """
        if not run_folder.is_dir():
            raise cls(
                f"{run_folder} was moved or removed while the run was at work in it: "
                "resume=<where it is now> goes on from its last checkpoint"
            )


class NonFiniteWeightsError(TrainingError):
    """Weights are NaN or infinite: whatever acts by them tells nothing of an agent."""

    @classmethod
    def check(cls, policy: nn.Module, where: object) -> None:
        """Raises the error if a policy has such weights.

        Args:
            policy: what acts by them.
            where: they are from: a folder, for the sentence.

        Raises:
            NonFiniteWeightsError: always then.
        """
        for name, weight in policy.named_parameters():
            if not bool(weight.isfinite().all()):
                raise cls(
                    f"{where} has weights that are NaN or infinite ({name}), by which no agent can "
                    "act: train anew, with a smaller agent.lr where that was the cause"
                )


class NonFiniteLossError(TrainingError):
    """A replica's loss became NaN or infinite; the state of the training has been saved."""
