"""The DQN loss, with dropout in the prediction only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.objectives.held import Holds
from bbq_torchrl.objectives.q_learning import OneStepQLoss

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor, nn
    from torchrl.data import TensorSpec
    from torchrl.modules import QValueActor

    from bbq_torchrl.objectives.td_loss import Distance

__all__ = ["DropoutDQNLoss"]


class DropoutDQNLoss(Holds, OneStepQLoss):
    """The DQN loss of a stack of networks, dropout on in the prediction and off in the target.

    TorchRL's DQNLoss leaves dropout to the training flag: in training mode the targets are
    random, and ``policy.eval()`` (policy and loss share the network) turns it off in the loss.

    Args:
        value_network: an actor, or a network that maps the observation to values.

    Keyword Args:
        gamma: discount of the one-step target, a number or a tensor [*stack]. Defaults to 0.9.
        action_space: "categorical", "one-hot" or the action's spec; taken from the actor if it
            has one.
        delay_value: whether the target is a frozen copy of the network. Defaults to True.
        double_dqn: whether the online network chooses the target's action. Defaults to False.
        loss_function: "l2", "l1" or "smooth_l1". Defaults to "l2".
        hold: whether a batch's dropout is taken from a pool that is made at the first batch after
            :meth:`begin_epoch` and held until the next call
            (:class:`~bbq_torchrl.bayes.noise_pool`), which saves a twentieth of an update on a
            CPU; elsewhere nothing is held. Defaults to False.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from torchrl.objectives import HardUpdate
        >>> from bbq_torchrl.networks import FlatMLP, q_actor
        >>> from bbq_torchrl.objectives import DropoutDQNLoss
        >>> actor = q_actor(FlatMLP(3, 4, stack=(5,), dropout=0.5), Categorical(4))
        >>> loss = DropoutDQNLoss(actor)
        >>> freeze = HardUpdate(loss, value_network_update_interval=0)
        >>> state = dict(observation=torch.ones(5, 32, 3), action_mask=torch.ones(5, 32, 4).bool())
        >>> end = dict(reward=torch.ones(5, 32, 1), terminated=torch.ones(5, 32, 1).bool())
        >>> td = TensorDict(
        ...     {**state, "action": torch.ones(5, 32).long(), "next": {**state, **end}}, [5, 32]
        ... )
        >>> sorted(loss(td).keys()), loss(td)["loss_value"].shape
        (['loss', 'loss_value', 'q_value', 'td_error'], torch.Size([5]))
    """

    def __init__(
        self,
        value_network: QValueActor | nn.Module,
        *,
        gamma: float | Tensor = 0.9,
        action_space: str | TensorSpec | None = None,
        delay_value: bool = True,
        double_dqn: bool = False,
        loss_function: Distance = "l2",
        hold: bool = False,
    ) -> None:
        super().__init__(
            value_network,
            gamma=gamma,
            action_space=action_space,
            delay_value=delay_value,
            double_dqn=double_dqn,
            loss_function=loss_function,
        )
        self._register_hold(hold)

    def _predict(
        self, tensors: Sequence[Tensor], inputs: Sequence[Tensor]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        with self._random_numbers(tensors):
            return self._function(tensors, inputs, "draw"), {}
