"""The DQN losses: with dropout in the prediction only, and with the noise of a NoisyNet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bbq_torchrl.networks.noisy_mlp import noisy_layers
from bbq_torchrl.objectives.q_learning import OneStepQLoss

if TYPE_CHECKING:
    from torch import nn
    from torchrl.modules import QValueActor

    from bbq_torchrl.bayes.scope import WeightMode


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

    Examples:
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

    out_keys = list(OneStepQLoss.out_keys)  # noqa: RUF012 - TorchRL looks for a class's own


class NoisyDQNLoss(OneStepQLoss):
    """NoisyNet's DQN loss of replicas of a network (Fortunato et al., Noisy Networks, ICLR 2018).

    With parameters ζ = (μ, σ), frozen ones ζ⁻ and independent noises ε, ε', ε'', one of each for
    a batch, each network's loss is the mean over the batch of (y - Q(s, a, ε; ζ))² with

        y = r + γ max_a Q(s', a, ε'; ζ⁻), or in double DQN
        y = r + γ Q(s', argmax_a Q(s', a, ε''; ζ), ε'; ζ⁻)

    as in NoisyNet-DQN (the double form is the one that the paper gives for NoisyNet-Dueling); y
    is a constant. :class:`DropoutDQNLoss` on the same network takes μ in the target in place of
    ε' and ε''.

    Args:
        value_network: an actor, or a network that maps the observation to values, with noisy
            layers (:class:`~bbq_torchrl.networks.NoisyMLP`).
        **settings: the keywords of :class:`DropoutDQNLoss`.

    Raises:
        ValueError: for an argument outside of what is listed, or a network without noisy layers.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from torchrl.objectives import HardUpdate
        >>> from bbq_torchrl.networks import NoisyMLP, q_actor
        >>> from bbq_torchrl.objectives import NoisyDQNLoss
        >>> actor = q_actor(NoisyMLP(3, 4, replicas=5), Categorical(4))
        >>> loss = NoisyDQNLoss(actor, double_dqn=True)
        >>> freeze = HardUpdate(loss, value_network_update_interval=0)
        >>> state = dict(observation=torch.ones(5, 32, 3), action_mask=torch.ones(5, 32, 4).bool())
        >>> end = dict(reward=torch.ones(5, 32, 1), terminated=torch.ones(5, 32, 1).bool())
        >>> td = TensorDict(
        ...     {**state, "action": torch.ones(5, 32).long(), "next": {**state, **end}}, [5, 32]
        ... )
        >>> sorted(loss(td).keys()), loss(td)["loss_value"].shape
        (['loss', 'loss_value', 'q_value', 'td_error'], torch.Size([5]))
    """

    out_keys = list(OneStepQLoss.out_keys)  # noqa: RUF012 - TorchRL looks for a class's own
    _target_mode: WeightMode = "draw"

    def __init__(self, value_network: QValueActor | nn.Module, **settings: Any) -> None:
        super().__init__(value_network, **settings)
        noisy_layers(self.value_network)
