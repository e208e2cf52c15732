"""A Bayesian model of an environment's dynamics (VIME, Houthooft et al. 2016), and its loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.objectives import LossModule

from bbq_torchrl.bayes.bayes_mlp import BayesMLP
from bbq_torchrl.bayes.functional import as_rows
from bbq_torchrl.bayes.layers import MeanInit
from bbq_torchrl.bayes.scope import KLSum, WeightMode, weight_scope
from bbq_torchrl.objectives.td_loss import NumData, row_weights
from bbq_torchrl.settings import ABOVE_ZERO, AT_LEAST_ZERO, COUNT, at_least, check


class DynamicsModel(nn.Module):
    """A Bayesian network that predicts the next state (VIME, Houthooft et al. 2016).

    The likelihood of the standardized next state is a Gaussian around the network's output with
    standard deviation ``noise_std``, independent for each feature. States are standardized by
    running statistics of each replica, see :meth:`standardize`. Storing transitions
    (:class:`~bbq_torchrl.vime.VIMEReward`) updates the statistics; losses only read them. TorchRL's
    ``RunningMeanStd`` does not fit: it shares its statistics over all leading dimensions, counts
    every row, and has no floor.

    Args:
        observation_size: features of a state, S.
        action_size: number of discrete actions, or size of a continuous action, A.
        hidden: sizes of the hidden layers. Defaults to (64, 64).

    Keyword Args:
        replicas: leading shape of independent models. Defaults to ().
        prior_std: standard deviation of the weights' prior, or "fan_in", as in
            :class:`~bbq_torchrl.bayes.BayesMLP`. Defaults to 0.1.
        noise_std: standard deviation of the likelihood, in units of the standardized state.
            Defaults to 1.
        std_floor: the minimum standard deviation that a feature is divided by. A feature that
            changes in one row of a thousand has a standard deviation of 0.03, a constant one 0, so
            without a floor a single change would outweigh everything else. Defaults to 0.05.
        mean_init: "kaiming" or "zero". With zero means no error reaches the hidden layers, and all
            gain comes from the last bias until training breaks the symmetry. Defaults to
            "kaiming".
        std_init: initial standard deviation of the weights; None for the prior's. Defaults to
            None.
        device: device of parameters and buffers.
        dtype: dtype of parameters and buffers.

    Attributes:
        network: the :class:`~bbq_torchrl.bayes.BayesMLP`, S + A inputs and S outputs.
        mean: buffer [*replicas, S], running mean of each feature, initially 0.
        var: buffer [*replicas, S], running (population) variance, initially 1.
        count: int64 buffer [*replicas], the number of states in both statistics.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.vime import DynamicsModel
        >>> dynamics = DynamicsModel(268, 39, replicas=5)
        >>> state, action = torch.rand(5, 32, 268), torch.randint(39, (5, 32))
        >>> dynamics.update_statistics(state)
        >>> dynamics(state, action, "draw").shape
        torch.Size([5, 32, 268])
    """

    mean: Tensor
    var: Tensor
    count: Tensor

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        hidden: Sequence[int] = (64, 64),
        *,
        replicas: int | Sequence[int] = (),
        prior_std: float | Tensor | Literal["fan_in"] = 0.1,
        noise_std: float = 1.0,
        std_floor: float = 0.05,
        mean_init: MeanInit = "kaiming",
        std_init: float | Tensor | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        for name, size in (("observation_size", observation_size), ("action_size", action_size)):
            check(name, size, at_least(1))
        check("noise_std", noise_std, ABOVE_ZERO)
        check("std_floor", std_floor, ABOVE_ZERO)
        self.observation_size = observation_size
        self.action_size = action_size
        self.noise_std = noise_std
        self.std_floor = std_floor
        self.network = BayesMLP(
            observation_size + action_size,
            observation_size,
            hidden,
            replicas=replicas,
            prior_std=prior_std,
            mean_init=mean_init,
            std_init=std_init,
            device=device,
            dtype=dtype,
        )
        shape = (*self.replicas, observation_size)
        mu = self.network.posterior.mu
        self.register_buffer("mean", mu.new_zeros(shape))
        self.register_buffer("var", mu.new_ones(shape))
        self.register_buffer("count", mu.new_zeros(self.replicas, dtype=torch.int64))

    @property
    def replicas(self) -> torch.Size:
        """Leading shape of weights and statistics."""
        return self.network.replicas

    def reset_parameters(self) -> None:
        """Initializes the weights again; the statistics are unchanged."""
        self.network.reset_parameters()

    # -- statistics -------------------------------------------------------------------------

    @property
    def std(self) -> Tensor:
        """The divisor of each feature, [*replicas, S], at least ``std_floor``."""
        return self.var.sqrt().clamp_min(self.std_floor)

    @torch.no_grad()
    def update_statistics(self, observation: Tensor, valid: Tensor | None = None) -> None:
        """Updates the running mean and variance (Welford's parallel algorithm).

        Args:
            observation: shape [*replicas, *rows, S].
            valid: bool [*replicas, *rows], True for valid rows; None for all. Other rows may
                contain anything, and a replica without valid rows keeps its statistics bitwise.
        """
        x = self._rows(observation).reshape(*self.replicas, -1, self.observation_size)
        if valid is None:
            mask = torch.ones(x.shape[:-1], dtype=torch.bool, device=x.device)
        else:
            mask = valid.reshape(x.shape[:-1])
        mask = mask.unsqueeze(-1)
        number = mask.sum(-2)  # [*replicas, 1]
        total = self.count.unsqueeze(-1) + number
        divisor = number.clamp_min(1).to(x.dtype)
        mean = torch.where(mask, x, 0).sum(-2) / divisor
        var = torch.where(mask, x - mean.unsqueeze(-2), 0).square().sum(-2) / divisor
        share = number / total.clamp_min(1).to(x.dtype)
        delta = mean - self.mean
        merged = self.var.lerp(var, share) + delta.square() * (share * (1 - share))
        is_new = number > 0
        self.mean.copy_(torch.where(is_new, torch.addcmul(self.mean, delta, share), self.mean))
        self.var.copy_(torch.where(is_new, merged, self.var))
        self.count.copy_(total.squeeze(-1))

    def standardize(self, observation: Tensor) -> Tensor:
        """Returns (observation - mean) / max(std, std_floor), shape [*replicas, *rows, S].

        This is the identity before the first :meth:`update_statistics`.

        Args:
            observation: shape [*replicas, *rows, S], of any dtype.

        Raises:
            ValueError: for a wrong shape.
        """
        mean, std = (each.reshape(-1, 1, self.observation_size) for each in (self.mean, self.std))
        return ((self._rows(observation) - mean) / std).reshape(observation.shape)

    def _rows(self, observation: Tensor) -> Tensor:
        """Returns states [*replicas, *rows, S] as [L, rows, S] in the model's dtype."""
        rows = as_rows(observation, self.replicas, self.observation_size, name="observation")
        return rows.to(self.mean.dtype)

    # -- network ----------------------------------------------------------------------------

    def encode_action(self, action: Tensor, rows: Sequence[int]) -> Tensor:
        """Returns the action as the network's input, shape [*rows, A] in the model's dtype.

        Args:
            action: an index, shape [*rows] or [*rows, 1]; one-hot, bool or integer [*rows, A]; or
                floating-point [*rows, A] (one-hot or continuous), which is not changed. An invalid
                index, as in an invalid row, becomes zeros.
            rows: the batch shape.

        Raises:
            ValueError: for a wrong shape.
        """
        rows = tuple(rows)
        size, dtype = self.action_size, self.mean.dtype
        if action.shape == (*rows, size) and (size > 1 or action.is_floating_point()):
            return action.to(dtype)
        if action.is_floating_point() or action.shape not in (rows, (*rows, 1)):
            raise ValueError(
                f"action must be an index of shape {list(rows)} or have shape "
                f"{[*rows, size]}, got {action.dtype} {list(action.shape)}"
            )
        indices = torch.arange(size, device=action.device)
        return (action.reshape(*rows, 1) == indices).to(dtype)

    def inputs(self, observation: Tensor, action: Tensor) -> Tensor:
        """Returns the network's input, standardized state and action, [*replicas, *rows, S + A].

        Args:
            observation: shape [*replicas, *rows, S].
            action: as in :meth:`encode_action`.
        """
        state = self.standardize(observation)
        return torch.cat([state, self.encode_action(action, state.shape[:-1])], -1)

    def forward(
        self,
        observation: Tensor,
        action: Tensor,
        mode: WeightMode | None = None,
        weights: Tensor | None = None,
    ) -> Tensor:
        """Returns the prediction of the standardized next state, [*replicas, *rows, S].

        Args:
            observation: state, shape [*replicas, *rows, S].
            action: as in :meth:`encode_action`.
            mode: as in :meth:`BayesLayer.forward`.
            weights: as in :meth:`BayesLayer.forward`.
        """
        return self.network(self.inputs(observation, action), mode, weights)


class DynamicsLoss(NumData, LossModule):
    """The negative evidence lower bound of a dynamics model, per transition.

    For N transitions in the buffer each model's loss is

        mean over the batch of Σ_features (s' - ŝ'(s, a; w))² / (2 noise_std²)
            + kl_temperature · KL / N

    in standardized states, up to a constant, with one weight draw w per batch. Terminated
    transitions are not predicted: they add 0 to the sum but count as rows, so N is the length of
    the buffer, and Bayes' rule weighs data and KL. Rows can be left out: ``loss_mask_key``
    (TorchRL's attribute, by default "valid") names an optional bool entry [*replicas, *batch] that
    is True for valid rows. The weights of prioritized replay apply as in the Q-learning losses.

    Reads a TensorDict [*replicas, *batch] with the observation, the action, and under "next" the
    observation and terminated [*replicas, *batch, 1]. ``loss`` is the sum of the replicas' losses,
    so no replica's gradient depends on another's data. The model's running statistics are read, not
    changed.

    Args:
        dynamics: the model, shared with the intrinsic reward; a submodule of the loss.

    Keyword Args:
        kl_temperature: factor of the KL; 1 is Bayes' rule. Defaults to 1.
        every: trains the dynamics every this many batches. For other batches "loss" is 0 and the
            last metrics are reported again. The batch count is part of the state, and
            :meth:`begin_epoch` restarts it. Defaults to 1.
        num_data: N, a number or a tensor [*replicas]. If None, call :meth:`set_num_data` before
            the first loss.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from bbq_torchrl.vime import DynamicsModel
        >>> from bbq_torchrl.vime import DynamicsLoss
        >>> loss = DynamicsLoss(DynamicsModel(3, 4, replicas=5), num_data=1000)
        >>> end = dict(observation=torch.zeros(5, 32, 3), terminated=torch.ones(5, 32, 1).bool())
        >>> td = TensorDict(
        ...     dict(observation=torch.ones(5, 32, 3), action=torch.ones(5, 32).long(), next=end),
        ...     [5, 32],
        ... )
        >>> out = loss(td)
        >>> out["loss"].backward()
        >>> sorted(out.keys()), out["dynamics_kl"].shape
        (['dynamics_kl', 'dynamics_loss', 'loss'], torch.Size([5]))
    """

    @dataclass
    class _AcceptedKeys:
        """The keys that :meth:`set_keys` sets.

        Attributes:
            observation: the state, at the root and under "next".
            action: an index, or a vector such as one-hot.
            terminated: read under "next".
            priority_weight: the optional row weights of prioritized replay.
        """

        observation: NestedKey = "observation"
        action: NestedKey = "action"
        terminated: NestedKey = "terminated"
        priority_weight: NestedKey = "priority_weight"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    dynamics: DynamicsModel
    reported: Tensor
    out_keys = ["loss", "dynamics_loss", "dynamics_kl"]  # noqa: RUF012 - as in TorchRL

    def __init__(
        self,
        dynamics: DynamicsModel,
        *,
        kl_temperature: float = 1.0,
        every: int = 1,
        num_data: int | Tensor | None = None,
    ) -> None:
        check("kl_temperature", kl_temperature, AT_LEAST_ZERO)
        check("every", every, COUNT)
        super().__init__()
        self.dynamics = dynamics
        self.every = every
        # on the host, so that skipping a batch does not wait for the device
        self.batches = 0
        self.replicas = dynamics.replicas
        self.kl_temperature = kl_temperature
        self._register_num_data(num_data, dynamics.network.posterior.mu)
        self.register_buffer("reported", self.num_data.new_zeros((2, *self.replicas)))
        self._set_in_keys()

    def _set_in_keys(self) -> None:
        keys = self.tensor_keys
        self.in_keys = [
            keys.observation,
            keys.action,
            unravel_key(("next", keys.observation)),
            unravel_key(("next", keys.terminated)),
        ]

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        self._set_in_keys()

    def reset_parameters_recursive(self) -> None:
        """Initializes the model's weights again."""
        self.dynamics.reset_parameters()

    def begin_epoch(self) -> None:
        """Restarts the schedule: the next batch trains the dynamics, and then every ``every``-th.

        Call it before each epoch if the replicas' epochs differ in length
        (:class:`~bbq_torchrl.data.ReplicaReplay`). Otherwise the length of one replica's epoch
        would decide which batches of the next epoch train the dynamics of the others.
        """
        self.batches = 0

    def get_extra_state(self) -> Tensor:
        """Returns the number of batches since the schedule began, int64, shape []."""
        return torch.tensor(self.batches)

    def set_extra_state(self, state: Tensor) -> None:
        """Restores the state from :meth:`get_extra_state`."""
        self.batches = int(state)

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns the losses of a batch of transitions.

        Args:
            tensordict: a batch [*replicas, *batch].

        Returns:
            a TensorDict with the scalar "loss" to differentiate and, without a graph,
            "dynamics_loss" and "dynamics_kl" (in nats), each [*replicas].

        Raises:
            RuntimeError: if N is unknown.
        """
        self._check_num_data()
        is_due = self.batches % self.every == 0
        self.batches += 1
        loss = self._loss(tensordict) if is_due else self.reported.new_zeros(())
        dynamics_loss, dynamics_kl = self.reported.clone().unbind(0)
        return TensorDict(
            {"loss": loss, "dynamics_loss": dynamics_loss, "dynamics_kl": dynamics_kl}
        )

    def _loss(self, tensordict: TensorDictBase) -> Tensor:
        """Returns the sum of the replicas' losses, and records the metrics."""
        observation, action, following, terminated = (tensordict[key] for key in self.in_keys)
        rows = observation.shape[:-1]
        predicted = ~terminated.bool().reshape(*rows, 1)
        weight = row_weights(self, tensordict, rows)
        inputs = self.dynamics.inputs(observation, action)
        if weight is not None:
            valid = weight != 0
            predicted = predicted & valid
            # Mask before multiplying: an ignored row may contain anything.
            inputs = torch.where(valid, inputs, 0)
        kl_sum = KLSum()
        with weight_scope("draw", kl=kl_sum):
            output = self.dynamics.network(inputs)
        error = output - self.dynamics.standardize(following)
        square = torch.where(predicted, error, 0).square().sum(-1)
        number: float | Tensor = max(1, rows[len(self.replicas) :].numel())
        if weight is not None:
            weight = weight.squeeze(-1).to(square.dtype)
            square = square * weight
            # 0 / tiny without valid rows
            number = self._flat(weight).sum(-1).clamp_min(torch.finfo(weight.dtype).tiny)
        sums = self._flat(square).sum(-1) * (0.5 / self.dynamics.noise_std**2)
        kl = kl_sum.total()
        loss = sums / number + kl * (self.kl_temperature / self.num_data)
        self.reported.copy_(torch.stack([loss.detach(), kl.detach()]))
        return loss.sum()

    def _flat(self, tensor: Tensor) -> Tensor:
        """Returns [*replicas, *batch] as [*replicas, B]."""
        return tensor.reshape(*self.replicas, -1)


def vime_losses(q_loss: nn.Module, dynamics_loss: DynamicsLoss) -> nn.ModuleDict:
    """Returns a Q-learning loss and the dynamics' loss, to be trained together."""
    return nn.ModuleDict({"q_loss": q_loss, "dynamics_loss": dynamics_loss})
