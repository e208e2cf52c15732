"""Acting and learning with an epistemic index, an input of the network."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torchrl.envs.utils import ExplorationType, exploration_type

from bbq_torchrl.exploration import ActorPolicy
from bbq_torchrl.objectives import OneStepQLoss

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor
    from torchrl.modules import QValueActor

INDEX = "index"
"""TensorDict key of the index, [*batch, index_size]."""


class IndexSampling(ActorPolicy):
    """Acts greedily with one index, drawn for each row and kept until its episode ends.

    Explores under RANDOM and outside of any context (as TorchRL's ``EGreedyModule``), else acts
    with the index 0, which is the base network.

    Args:
        actor: a Q-value actor that reads the index.
        index_size: dimensions of the index.

    Keyword Args:
        explores: False: acts with the index 0 whatever the exploration type.

    Examples:
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from bbq_extending.epinet_mlp import EpinetMLP
        >>> from bbq_torchrl.networks import q_actor
        >>> network = EpinetMLP(3, 4, (8,), index_size=2)
        >>> keys = ("observation", INDEX)
        >>> actor = q_actor(network, Categorical(4), in_keys=keys, action_mask_key=None)
        >>> policy = IndexSampling(actor, 2)
        >>> rows = TensorDict(observation=torch.ones(5, 3), batch_size=[5])
        >>> first, again = policy(rows.clone()), policy(rows.clone())
        >>> first["action"].shape, torch.equal(first["action_value"], again["action_value"])
        (torch.Size([5]), True)
    """

    def __init__(self, actor: QValueActor, index_size: int, *, explores: bool = True) -> None:
        super().__init__(actor)
        self.index_size = index_size
        self.explores = explores
        self.in_keys = [key for key in actor.in_keys if key != INDEX]
        self._held: Tensor | None = None

    def resample(self) -> None:
        """Forgets the indices: the next call draws new ones."""
        self._held = None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action and the values that it comes from, [*batch, actions]."""
        rows = tensordict.select(*self.in_keys)
        shape = (*tensordict.batch_size, self.index_size)
        index = torch.zeros(shape, device=rows[self.in_keys[0]].device)
        if self.explores and exploration_type() in (ExplorationType.RANDOM, None):
            index = self._held = self._next(tensordict, torch.randn_like(index))
        return tensordict.update(self.actor(rows.set(INDEX, index)).select(*self.out_keys))

    def _next(self, tensordict: TensorDictBase, drawn: Tensor) -> Tensor:
        """Returns the current indices, with new ones where an episode begins."""
        if self._held is None or self._held.shape != drawn.shape:
            return drawn
        begins = tensordict.get("is_init", None)
        if begins is None:
            return self._held
        return torch.where(begins.reshape(*tensordict.batch_size, 1), drawn, self._held)


class IndexLoss(OneStepQLoss):
    """The squared TD error with one index per row, shared with the row's target.

    Takes what :class:`~bbq_torchrl.objectives.OneStepQLoss` takes, and an actor that reads the
    index; writes the indices into the batch.

    Args:
        value_network: the actor.
        index_size: dimensions of the index.
    """

    def __init__(self, value_network: QValueActor, index_size: int, **keywords: object) -> None:
        super().__init__(value_network, **keywords)  # type: ignore[arg-type]
        self.index_size = index_size

    @property
    def has_fixed_targets(self) -> bool:
        """False: a row's target depends on its index."""
        return False

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns the losses of a batch of transitions, as ``OneStepQLoss`` does."""
        shape = (*tensordict.batch_size, self.index_size)
        index = torch.randn(shape, device=tensordict.get(("next", self.tensor_keys.reward)).device)
        tensordict.set(INDEX, index)
        tensordict.set(("next", INDEX), index)
        return super().forward(tensordict)
