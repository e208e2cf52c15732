"""DQN losses: with dropout in the prediction, for NoisyNets, and for bootstrap heads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.modules import QValueActor

from bbq_torchrl.bayes.scope import WeightMode
from bbq_torchrl.networks.mlp import noisy_layers
from bbq_torchrl.objectives.q_learning import OneStepQLoss
from bbq_torchrl.objectives.td_loss import normalized_weights, td_loss


class DropoutDQNLoss(OneStepQLoss):
    """The DQN loss with dropout on in the prediction and off in the target, for replicas.

    TorchRL's DQNLoss leaves dropout to the training flag: in training mode the targets are random,
    and ``policy.eval()`` turns it off in the loss too, as policy and loss share the network.

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

    out_keys = list(OneStepQLoss.out_keys)  # noqa: RUF012 - TorchRL reads the class's __dict__


class NoisyDQNLoss(OneStepQLoss):
    """NoisyNet's DQN loss (Fortunato et al., Noisy Networks, ICLR 2018), for replicas.

    With parameters ζ = (μ, σ), frozen parameters ζ⁻ and independent noises ε, ε', ε'', each drawn
    once per batch, each network's loss is the mean over the batch of (y - Q(s, a, ε; ζ))² with

        y = r + γ max_a Q(s', a, ε'; ζ⁻), or in double DQN
        y = r + γ Q(s', argmax_a Q(s', a, ε''; ζ), ε'; ζ⁻)

    as in NoisyNet-DQN (the double form is the paper's for NoisyNet-Dueling); y is a constant.
    On the same network :class:`DropoutDQNLoss` uses μ in the target, without ε' and ε''.

    Args:
        value_network: an actor, or a network that maps the observation to values, with noisy
            layers (:class:`~bbq_torchrl.networks.NoisyMLP`).
        **settings: the keyword arguments of :class:`DropoutDQNLoss`.

    Raises:
        ValueError: for an invalid argument, or a network without noisy layers.

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

    out_keys = list(OneStepQLoss.out_keys)  # noqa: RUF012 - TorchRL reads the class's __dict__
    _target_mode: WeightMode = "draw"

    def __init__(self, value_network: QValueActor | nn.Module, **settings: Any) -> None:
        super().__init__(value_network, **settings)
        noisy_layers(self.value_network)


class BootstrapDQNLoss(OneStepQLoss):
    """The DQN loss of K heads, each with a separate target and a separate share of the data.

    The target of a head is r + γ max Q(s', ·) of its frozen copy; with ``double_dqn``, the online
    head chooses the action and its frozen copy evaluates it. A head's loss is the mean over its
    rows, and the heads' losses are summed, so each head learns as it would alone.
    (:class:`~bbq_torchrl.networks.BootstrapMLP` divides the gradient of a shared trunk by K, so
    the trunk follows the mean of the heads' losses.)

    Reads the entries of :class:`OneStepQLoss` and optionally ``bootstrap_mask`` (bool
    [*replicas, *batch, K], True where the head learns from the row; TorchRL's ``set_keys`` renames
    it), combined with "valid". Without it all heads learn from every row. Rows that no head learns
    from may contain anything, including NaN.

    Args:
        value_network: an actor from :func:`~bbq_torchrl.networks.bootstrap_actor`, or a network
            that maps the observation to values [*replicas, *batch, K, N].

    Keyword Args:
        gamma: discount of the one-step target, a number or a tensor [*replicas]. Defaults to 0.9.
        action_space: "categorical", "one-hot" or the action's spec; taken from the actor if it
            has one.
        delay_value: whether the target is a frozen copy of the network. Defaults to True.
        double_dqn: whether each online head chooses its target's action. Defaults to False.
        loss_function: "l2", "l1" or "smooth_l1". Defaults to "l2".

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from torchrl.objectives import HardUpdate
        >>> from bbq_torchrl.networks import BootstrapMLP, bootstrap_actor
        >>> from bbq_torchrl.objectives import BootstrapDQNLoss
        >>> actor = bootstrap_actor(BootstrapMLP(3, 4, heads=10, replicas=5), Categorical(4))
        >>> loss = BootstrapDQNLoss(actor)
        >>> freeze = HardUpdate(loss, value_network_update_interval=0)
        >>> state = dict(observation=torch.ones(5, 32, 3), action_mask=torch.ones(5, 32, 4).bool())
        >>> end = dict(reward=torch.ones(5, 32, 1), terminated=torch.ones(5, 32, 1).bool())
        >>> td = TensorDict(
        ...     {**state, "action": torch.ones(5, 32).long(), "next": {**state, **end}}, [5, 32]
        ... )
        >>> td["bootstrap_mask"] = torch.rand(5, 32, 10) < 0.5
        >>> out = loss(td)
        >>> out["loss"].backward()
        >>> sorted(out.keys()), out["loss_value"].shape
        (['loss', 'loss_value', 'q_value', 'td_error'], torch.Size([5]))
    """

    @dataclass
    class _AcceptedKeys(OneStepQLoss._AcceptedKeys):
        """The keys that ``set_keys`` can change.

        Attributes:
            bootstrap_mask: mask of heads that learn from a row. Defaults to ``"bootstrap_mask"``.
        """

        bootstrap_mask: NestedKey = "bootstrap_mask"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    out_keys = list(OneStepQLoss.out_keys)  # noqa: RUF012 - TorchRL reads the class's __dict__

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns the losses of a batch of transitions.

        Also writes the squared TD error [*replicas, *batch, 1], averaged over the heads that learn
        from the row, into the input under the priority key, for prioritized replay.

        Args:
            tensordict: a batch [*replicas, *batch].

        Returns:
            a TensorDict with the scalar "loss" to differentiate, the sum over heads and replicas,
            and, without a graph, "loss_value", "td_error" (mean of |Q - target|) and "q_value"
            (mean of Q at the actions taken), each [*replicas]. These are means over the heads that
            learn from any row of the batch, so their scale does not depend on K.
        """
        keys = self.tensor_keys
        online, target = self._tensors()
        reward, index = self._reward_and_index(tensordict)
        mask = tensordict.get(keys.bootstrap_mask, None)
        weight = self._head_weights(tensordict, mask, reward)
        values = self._function(online, self._inputs(tensordict, weight), "draw")
        heads = values.shape[:-1]

        def by_head(entry: Tensor) -> Tensor:
            """Returns an entry [*replicas, *batch, n] as [*replicas, K, B, n]."""
            return self._by_head(self._like_values(entry).expand(*heads, entry.shape[-1]))

        with torch.no_grad():
            td_target = self._td_target(tensordict, online, target)
            rows = None if weight is None else self._by_head(weight.expand(heads).unsqueeze(-1))
        chosen = self._by_head(values), by_head(index)
        loss, td_error, q_value, square = td_loss(
            *chosen, self._by_head(td_target), rows, self.loss_function
        )
        if self._imitation is not None:
            loss = loss + self._imitation_loss(tensordict, *chosen, rows, by_head)
        learns = torch.ones_like(square) if rows is None else (rows > 0).to(square.dtype)
        share = learns.sum(-3).clamp_min_(1)
        tensordict.set(keys.priority, (square.sum(-3) / share).reshape(reward.shape), inplace=True)
        learns = learns.any(-2).squeeze(-1).to(square.dtype)
        learns /= learns.sum(-1, keepdim=True).clamp_min_(1)
        return TensorDict(
            {
                "loss": loss.sum(),
                "loss_value": (loss.detach() * learns).sum(-1),
                "td_error": (td_error * learns).sum(-1),
                "q_value": (q_value * learns).sum(-1),
            }
        )

    def _by_head(self, tensor: Tensor) -> Tensor:
        """Returns [*replicas, *batch, K, features] as [*replicas, K, B, features]."""
        dims = len(self.replicas)
        tensor = tensor.movedim(-2, dims)
        return tensor.reshape(*tensor.shape[: dims + 1], -1, tensor.shape[-1])

    def _like_values(self, entry: Tensor) -> Tensor:
        """Returns an entry [*replicas, *batch, n] as [*replicas, *batch, 1, n], for all heads."""
        return entry.unsqueeze(-2)

    def _head_weights(
        self, tensordict: TensorDictBase, mask: Tensor | None, like: Tensor
    ) -> Tensor | None:
        """Returns row weights [*replicas, *batch, K or 1] that sum to 1 for each head."""
        weight = normalized_weights(self, tensordict, like)
        if mask is None:
            return weight
        learns = mask.to(torch.result_type(like, 1.0))  # rewards may be integers
        weight = learns if weight is None else learns * weight
        dims = tuple(range(len(self.replicas), like.ndim - 1))
        # 0 / tiny: a head that learns from no row has no gradient
        tiny = torch.finfo(weight.dtype).tiny
        return weight / weight.sum(dims, keepdim=True).clamp_min_(tiny)
