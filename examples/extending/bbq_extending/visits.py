"""``intrinsic=visits``: a reward for rarely seen states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bbq_torchrl.options import IntrinsicOption, register
from bbq_torchrl.options.task import over_replicas
from bbq_torchrl.settings import (
    NON_NEGATIVE,
    Values,
    integers,
    option,
    per_replica,
    setting,
)

if TYPE_CHECKING:
    from torchrl.envs import Transform
    from torchrl.objectives import LossModule

    from bbq_torchrl.options import Task


@register
@dataclass
class Visits(IntrinsicOption):
    """A bonus of 1/√n for a state seen n times, counted by a hash of its features."""

    name: str = option("visits")
    eta: Values = setting(0.1, per_replica(NON_NEGATIVE), "reward of a state that was seen once")
    bits: int = setting(16, integers(1, 24), "of the hash: 2**bits counters a replica")

    def make(self, loss: LossModule, task: Task) -> tuple[LossModule, list[Transform]]:
        """The agent's loss as it is, and the transform that counts and rewards."""
        from bbq_extending.visit_reward import VisitReward

        reward = VisitReward(
            task.inputs, replicas=task.replicas, eta=over_replicas(self.eta, task), bits=self.bits
        )
        return loss, [reward]
