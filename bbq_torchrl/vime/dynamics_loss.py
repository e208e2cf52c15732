"""The loss of a Bayesian model of the dynamics (VIME, Houthooft et al. 2016)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor, nn
from torchrl.objectives import LossModule

from bbq_torchrl.bayes.scope import KLSum, weight_scope
from bbq_torchrl.objectives.td_loss import NumData, row_weights
from bbq_torchrl.settings import AT_LEAST_ZERO, COUNT, check
from bbq_torchrl.vime.dynamics import DynamicsModel


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
