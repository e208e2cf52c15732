"""``agent=bootstrap``: heads that learn from a sample of the transitions each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import AgentOption, ConfigError, register
from bbq_torchrl.options.settings import (
    ABOVE_ZERO_TO_ONE,
    BOOLEAN,
    NON_NEGATIVE,
    NON_NEGATIVE_INTEGER,
    SIZE,
    option,
    optional,
    setting,
)
from bbq_torchrl.options.values import over_replicas

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.envs import Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule

    from bbq_torchrl.options import Config, Task


@register
@dataclass
class Bootstrap(AgentOption):
    """Bootstrapped DQN: heads that learn from a sample of the transitions each."""

    name: str = option("bootstrap")
    heads: int = setting(10, SIZE, "number of heads")
    trunk_layers: int | None = setting(
        None,
        optional(NON_NEGATIVE_INTEGER, "all hidden layers"),
        "hidden layers that the heads share; 0: as many networks as heads",
    )
    mask_prob: float = setting(
        1.0, ABOVE_ZERO_TO_ONE, "probability that a head learns from a transition"
    )
    prior_scale: float = setting(
        3.0, NON_NEGATIVE, "scale of the randomized prior functions; 0: none"
    )
    double: bool = setting(False, BOOLEAN, "choose the target's action by the online head")

    # Its greedy action is what most heads vote for: there is no value to put into a softmax.
    offers: ClassVar[tuple[str, ...]] = ("heads",)
    explores_by: ClassVar[str] = "bootstrap"

    def check(self, config: Config) -> None:
        """Refuses more shared layers than there are."""
        if (self.trunk_layers or 0) > len(self.hidden):
            raise ConfigError(
                f"agent.trunk_layers must be at most the {len(self.hidden)} layers of "
                f"agent.hidden, got {self.trunk_layers}"
            )

    def make_actor(self, task: Task) -> QValueActor:
        """A shared trunk and its heads."""
        from bbq_torchrl.networks import BootstrapMLP, bootstrap_actor

        network = BootstrapMLP(
            task.inputs,
            task.actions,
            self.hidden,
            heads=self.heads,
            replicas=task.replicas,
            trunk_layers=self.trunk_layers,
            prior_scale=self.prior_scale,
            device=task.device,
        )
        task.reset_inactive_(network)
        return bootstrap_actor(network, task.action_spec, action_mask_key=task.action_mask_key)

    def make_loss(self, actor: QValueActor, task: Task) -> LossModule:
        """The squared TD error of the heads that a transition is for."""
        from bbq_torchrl.objectives import BootstrapDQNLoss

        gamma = over_replicas(self.gamma, task)
        return BootstrapDQNLoss(actor, gamma=gamma, double_dqn=self.double)

    def make_greedy(self, actor: QValueActor) -> TensorDictModuleBase:
        """What most heads vote for."""
        from bbq_torchrl.exploration import MajorityVote

        return MajorityVote(actor)

    def make_evaluation(
        self, actor: QValueActor, mode: str | None = None
    ) -> tuple[str, TensorDictModuleBase]:
        """The vote."""
        return "vote", super().make_evaluation(actor, mode)[1]

    def make_transforms(self, task: Task) -> list[Transform]:
        """Draws for each stored transition the heads that learn from it."""
        from bbq_torchrl.data import BootstrapMask

        return [BootstrapMask(self.heads, self.mask_prob, replicas=task.replicas)]
