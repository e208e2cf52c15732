"""``agent=dqn``: a deep Q-network, with dropout or noisy layers if asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import AgentOption, ConfigError, register
from bbq_torchrl.options.settings import BELOW_ONE, BOOLEAN, option, setting
from bbq_torchrl.options.values import over_replicas

if TYPE_CHECKING:
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.options import Config, Task


@register
@dataclass
class DQN(AgentOption):
    """Deep Q-network, with or without dropout."""

    name: str = option("dqn")
    dropout: float = setting(
        0.0,
        BELOW_ONE,
        "probability of dropping a hidden unit in the prediction",
    )
    double: bool = setting(False, BOOLEAN, "choose the target's action by the online network")
    noisy: bool = setting(False, BOOLEAN, "NoisyNet layers in the place of dropout")

    offers: ClassVar[tuple[str, ...]] = ("values", "noise")

    def check(self, config: Config) -> None:
        """Refuses noise beside dropout, and a strategy that needs noise where there is none."""
        if self.noisy and self.dropout:
            raise ConfigError(
                "agent.noisy=true cannot be combined with agent.dropout="
                f"{self.dropout}: the noise takes its place, so agent.dropout must be 0"
            )
        if "noise" in config.explore.needs and not self.noisy:
            raise ConfigError(
                f"explore={config.explore.name} needs a network that has noise: agent.noisy must "
                "be true"
            )

    def make_actor(self, task: Task) -> QValueActor:
        """A ReLU network, its layers noisy if asked for."""
        from bbq_torchrl.networks import FlatMLP, NoisyMLP, q_actor

        sizes = (task.inputs, task.actions, self.hidden)
        network: FlatMLP | NoisyMLP
        if self.noisy:
            network = NoisyMLP(*sizes, replicas=task.replicas, device=task.device)
        else:
            network = FlatMLP(
                *sizes, replicas=task.replicas, dropout=self.dropout, device=task.device
            )
        task.reset_inactive_(network)
        return q_actor(network, task.action_spec, action_mask_key=task.action_mask_key)

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The squared TD error, with dropout or noise in the prediction."""
        from bbq_torchrl.objectives import DropoutDQNLoss, NoisyDQNLoss

        gamma = over_replicas(self.gamma, task)
        if self.noisy:
            return NoisyDQNLoss(actor, gamma=gamma, double_dqn=self.double)
        return DropoutDQNLoss(actor, gamma=gamma, double_dqn=self.double)
