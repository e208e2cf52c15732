"""The DQN loss, with dropout in the prediction only."""

from __future__ import annotations

from bbq_torchrl.objectives.q_learning import OneStepQLoss

__all__ = ["DropoutDQNLoss"]


class DropoutDQNLoss(OneStepQLoss):
    """The DQN loss of replicas of a network, dropout on in the prediction and off in the target.

    TorchRL's DQNLoss leaves dropout to the training flag: in training mode the targets are
    random, and ``policy.eval()`` (policy and loss share the network) turns it off in the loss.

    Args:
        value_network: an actor, or a network that maps the observation to values.

    Keyword Args:
        gamma: discount of the one-step target, a number or a tensor [*replicas]. Defaults to 0.9.
        action_space: "categorical", "one-hot" or the action's spec; taken from the actor if it
            has one.
        delay_value: whether the target is a frozen copy of the network. Defaults to True.
        double_dqn: whether the online network chooses the target's action. Defaults to False.
        loss_function: "l2", "l1" or "smooth_l1". Defaults to "l2".

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from torchrl.objectives import HardUpdate
        >>> from bbq_torchrl.networks import FlatMLP, q_actor
        >>> from bbq_torchrl.objectives import DropoutDQNLoss
        >>> actor = q_actor(FlatMLP(3, 4, replicas=5, dropout=0.5), Categorical(4))
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
