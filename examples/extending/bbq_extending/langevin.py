"""``agent=langevin``: Adam LMCDQN, a Q-network that explores by the noise of its optimizer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import AgentOption, register
from bbq_torchrl.options.task import over_replicas
from bbq_torchrl.settings import (
    BOOLEAN,
    NON_NEGATIVE,
    POSITIVE,
    Values,
    option,
    per_replica,
    setting,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from torch import nn
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.options import Task
    from bbq_torchrl.protocols import ReplicaOptimizer


@register
@dataclass
class Langevin(AgentOption):
    """Adam LMCDQN: a deep Q-network whose optimizer samples weights by Langevin dynamics."""

    name: str = option("langevin")
    inverse_temperature: Values = setting(
        1e8, per_replica(POSITIVE), "of the weights' distribution; the higher, the less noise"
    )
    bias: Values = setting(
        1.0, per_replica(NON_NEGATIVE), "factor of Adam's step, which is added to the gradient's"
    )
    double: bool = setting(True, BOOLEAN, "choose the target's action by the online network")

    provides: ClassVar[tuple[str, ...]] = ("values",)
    # The weights are a sample already, so the agent acts greedily on them.
    explores_by: ClassVar[str] = "greedy"

    def make_actor(self, task: Task) -> QValueActor:
        """A ReLU network."""
        from bbq_torchrl.networks import FlatMLP, q_actor

        network = FlatMLP(
            task.inputs, task.actions, self.hidden, replicas=task.replicas, device=task.device
        )
        task.reset_inactive_(network)
        return q_actor(network, task.action_spec, action_mask_key=task.action_mask_key)

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The squared TD error."""
        from bbq_torchrl.objectives import DropoutDQNLoss

        gamma = over_replicas(self.gamma, task)
        return DropoutDQNLoss(actor, gamma=gamma, double_dqn=self.double)

    def make_optimizer(
        self, actor: QValueActor, parameters: Iterable[nn.Parameter], task: Task
    ) -> ReplicaOptimizer:
        """Adam with noise on the Q-network's weights."""
        from bbq_extending.langevin_adam import LangevinAdam

        return LangevinAdam(
            parameters,
            task.replicas,
            noisy=list(actor.parameters()),
            lr=over_replicas(self.lr, task),
            inverse_temperature=over_replicas(self.inverse_temperature, task),
            bias=over_replicas(self.bias, task),
        )
