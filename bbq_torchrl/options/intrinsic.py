"""The options of ``intrinsic=``: a reward in addition to the task's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.task import keywords
from bbq_torchrl.settings import (
    COUNT,
    COUNTS,
    NON_NEGATIVE,
    POSITIVE,
    Values,
    integers,
    one_of,
    option,
    per_replica,
    setting,
)

if TYPE_CHECKING:
    from torch import nn
    from torchrl.envs import Transform
    from torchrl.objectives import LossModule

    from bbq_torchrl.options.task import Task


@dataclass
class IntrinsicOption(Option):
    """A reward in addition to the task's; reported rewards never include it."""

    group: ClassVar[str] = "intrinsic"

    def make(self, loss: LossModule, task: Task) -> tuple[nn.Module, list[Transform]]:
        """Returns the loss to train, and transforms of the replay buffer.

        Several losses are an ``nn.ModuleDict``, with the agent's first.

        Args:
            loss: the agent's loss.
            task: the task, for the sizes of a model.
        """
        return loss, []


@register
@dataclass
class NoIntrinsic(IntrinsicOption):
    """The task's reward alone."""

    name: str = option("none")


@register
@dataclass
class VIME(IntrinsicOption):
    """VIME: a reward for a transition's information gain about a Bayesian dynamics model."""

    name: str = option("vime")
    eta: Values = setting(0.1, per_replica(NON_NEGATIVE), "reward of the median information gain")
    weights: str = setting("map", one_of("map", "mc"), "gain at the mean weights, or at a draw")
    hidden: list[int] = setting([64, 64], COUNTS, "units of each hidden layer of the dynamics")
    prior_std: float = setting(0.1, POSITIVE, "std of the prior of the dynamics' weights")
    noise_std: float = setting(1.0, POSITIVE, "std of the standardized next state")
    std_floor: float = setting(0.05, POSITIVE, "lower bound of the std that divides a feature")
    step_size: float = setting(0.01, POSITIVE, "size of the second-order step that is measured")
    clip: float = setting(10.0, POSITIVE, "upper bound of the normalized information gain")
    median_window: int = setting(10, integers(1, 10**6), "rounds of the normalizing median")
    dynamics_every: int = setting(8, COUNT, "updates of Q for each update of the dynamics")

    def make(self, loss: LossModule, task: Task) -> tuple[nn.Module, list[Transform]]:
        """Adds the loss of the dynamics, and the transform that adds the bonus to the rewards."""
        import torch

        from bbq_torchrl.vime import DynamicsLoss, DynamicsModel, VIMEReward, vime_losses

        model = keywords(self, task, "prior_std", "noise_std", "std_floor")
        dynamics = DynamicsModel(task.inputs, task.actions, self.hidden, **task.place, **model)
        if task.inactive is not None:
            # The outputs are not reset: that a feature is constant can be learned beforehand.
            inputs, outputs = torch.cat(task.inactive), torch.zeros_like(task.inactive[0])
            with torch.no_grad():
                dynamics.network.reset_inactive_(inputs, outputs)
        names = ("eta", "weights", "step_size", "median_window", "clip")
        reward = VIMEReward(dynamics, **keywords(self, task, *names))
        return vime_losses(loss, DynamicsLoss(dynamics, every=self.dynamics_every)), [reward]
