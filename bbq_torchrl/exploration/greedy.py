"""Acting on the mean network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.bayes.scope import weight_scope
from bbq_torchrl.exploration.base import ActorPolicy

if TYPE_CHECKING:
    from tensordict import TensorDictBase


class Greedy(ActorPolicy):
    """Acts greedily on the mean network, whatever the exploration type.

    Dropout of this package's networks is off; ``nn.Dropout`` is as ``eval()`` and ``train()`` say.

    Args:
        actor: what chooses actions from values.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictSequential
        >>> from torchrl.data import Categorical
        >>> from torchrl.modules import EGreedyModule
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> from bbq_torchrl.exploration import Greedy
        >>> from bbq_torchrl.networks import q_actor
        >>> actor = q_actor(BayesMLP(3, 4), Categorical(4))
        >>> policy = TensorDictSequential(
        ...     Greedy(actor),
        ...     EGreedyModule(Categorical(4), 0.1, 0.1, action_mask_key="action_mask"),
        ... )
        >>> mask = torch.tensor([False, True, True, True]).expand(2, 4)
        >>> td = TensorDict(observation=torch.ones(2, 3), action_mask=mask, batch_size=[2])
        >>> bool((policy(td)["action"] > 0).all())
        True
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the greedy action and the values it comes from."""
        with weight_scope("mean"):
            return self.actor(tensordict)
