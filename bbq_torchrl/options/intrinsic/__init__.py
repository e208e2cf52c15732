"""The options of ``intrinsic=``: a reward of the agent's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option

if TYPE_CHECKING:
    from torchrl.envs import Transform
    from torchrl.objectives import LossModule

    from bbq_torchrl.options.task import Task

__all__ = ["IntrinsicOption"]


@dataclass
class IntrinsicOption(Option):
    """What the agent is rewarded for besides the task; never part of a reported reward."""

    group: ClassVar[str] = "intrinsic"

    def make(self, loss: LossModule, task: Task) -> tuple[LossModule, list[Transform]]:
        """Returns the loss that is learned, and what the replay buffer has to do for it.

        Args:
            loss: the agent's.
            task: what a model of the task has to fit.
        """
        return loss, []
