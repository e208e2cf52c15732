"""An upper confidence bound on Q-values, over draws of a Bayesian network's weights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torchrl.envs.utils import ExplorationType, exploration_type

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.exploration import ActorPolicy

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torchrl.modules import QValueActor


class UpperConfidence(ActorPolicy):
    """Takes the action of the highest mean + coefficient · std over draws of the weights.

    Explores under RANDOM and outside any context (as TorchRL's ``EGreedyModule``), else acts on
    the mean weights. Draws are independent for each row and step, by local reparameterization.

    Args:
        actor: a Q-value actor on a network with Bayesian layers.

    Keyword Args:
        coefficient: a number, or a tensor that broadcasts with the batch, such as [replicas, 1].
        draws: over which mean and std are taken, at least 2.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> policy = UpperConfidence(actor, coefficient=2.0)
        >>> policy(TensorDict(observation=torch.ones(5, 3), batch_size=[5]))["action"].shape
        torch.Size([5])
    """

    coefficient: torch.Tensor

    def __init__(
        self, actor: QValueActor, *, coefficient: float | torch.Tensor = 1.0, draws: int = 10
    ) -> None:
        super().__init__(actor)
        self.draws = draws
        values = torch.as_tensor(coefficient, dtype=torch.get_default_dtype())
        self.register_buffer("coefficient", values, persistent=False)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action, and the values it comes from, [*batch, actions]."""
        if exploration_type() not in (ExplorationType.RANDOM, None):
            with weight_scope("mean"):
                return self.actor(tensordict)
        network, choice = self.actor[0], self.actor[-1]
        rows = tensordict.select(*network.in_keys).unsqueeze(-1)
        with weight_scope("local"):
            values = network(rows.expand(*tensordict.batch_size, self.draws))
        std, mean = torch.std_mean(values.get(choice.action_value_key), -2)
        bound = mean + self.coefficient.unsqueeze(-1) * std
        return choice(tensordict.set(choice.action_value_key, bound))
