"""Acting on the noise of a NoisyNet."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.bayes.scope import WeightMode, weight_scope
from bbq_torchrl.exploration.base import ActorPolicy, explores
from bbq_torchrl.networks.noisy_mlp import noisy_layers

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torchrl.modules import QValueActor


class NoisySampling(ActorPolicy):
    """Acts greedily on noise that is new at every step (NoisyNet's exploration).

    Under the exploration types DETERMINISTIC, MEAN and MODE it acts on the mean network μ; under
    RANDOM and outside of any context it explores (as ``EGreedyModule``).

    Args:
        actor: an actor whose network has noisy layers.

    Keyword Args:
        shared: whether the rows of a batch act on one noise (each replica has its
            own) or each on its own, as if it were alone. Defaults to False.

    Raises:
        ValueError: for an actor without noisy layers.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_torchrl.exploration import NoisySampling
        >>> from bbq_torchrl.networks import NoisyMLP, q_actor
        >>> actor = q_actor(NoisyMLP(3, 4), Categorical(4), action_mask_key=None)
        >>> td = TensorDict(observation=torch.ones(50, 3), batch_size=[50])
        >>> NoisySampling(actor)(td)["action_value"].unique(dim=0).shape
        torch.Size([50, 4])
    """

    def __init__(self, actor: QValueActor, *, shared: bool = False) -> None:
        super().__init__(actor)
        noisy_layers(actor)
        self.shared = shared

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action that is greedy under the noise, and the values."""
        mode: WeightMode = "draw" if self.shared else "local"
        with weight_scope(mode if explores() else "mean"):
            return self.actor(tensordict)
