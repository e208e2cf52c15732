"""Annealed exploration: ε-greedy and Boltzmann."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.modules import EGreedyModule

from bbq_torchrl.exploration.base import explores, schedule
from bbq_torchrl.networks.q_actor import legal_actions

_WEIGHT = 0.2  # of the last round in the running mean of a replica's success rate


def _fallen(start: Tensor, end: Tensor, success: Tensor, rate: Tensor, until: float) -> Tensor:
    """Returns the value of a schedule that falls with success, [replicas, 1].

    Args:
        start: its value without a success.
        end: its value from a mean success of ``until`` on.
        success: the running mean of success, [replicas, 1]; updated.
        rate: the last round's, [replicas].
        until: the mean at which the fall ends.
    """
    success.lerp_(rate.to(success).unsqueeze(-1), _WEIGHT)
    return end + (start - end) * (1 - success / until).clamp_min(0)


class BatchedEGreedy(EGreedyModule):
    """TorchRL's ``EGreedyModule`` with a separate epsilon for each part of the batch.

    TorchRL's module compares its random numbers with buffers of any shape; only its constructor
    requires a single number. So this class replaces the buffers.

    Args:
        spec: the spec of the action.
        eps_init: initial epsilon, a number or a tensor that broadcasts with the batch, such as
            [*replicas, 1] for one per replica.
        eps_end: epsilon after ``annealing_num_steps`` steps, likewise.
        annealing_num_steps: length of the schedule.

    Keyword Args:
        action_key: as in ``EGreedyModule``.
        action_mask_key: bool [*batch, N], or None for no mask.
        until_success: see :class:`Boltzmann`.

    Raises:
        ValueError: unless 1 ≥ eps_init ≥ eps_end ≥ 0 and the schedule has a step.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> epsilon = torch.tensor([[0.0], [1.0]])
        >>> explore = BatchedEGreedy(Categorical(4), epsilon, epsilon, 1)
        >>> td = TensorDict(action=torch.zeros(2, 100).long(), batch_size=[2, 100])
        >>> explore(td)["action"].float().mean(-1)
        tensor([0.0000, ...])
    """

    success: Tensor

    def __init__(
        self,
        spec: TensorSpec,
        eps_init: float | Tensor,
        eps_end: float | Tensor,
        annealing_num_steps: int = 1000,
        *,
        action_key: NestedKey = "action",
        action_mask_key: NestedKey | None = None,
        until_success: float | None = None,
    ) -> None:
        start, end = schedule(eps_init, eps_end, annealing_num_steps)
        if not bool(((start <= 1) & (start >= end) & (end >= 0)).all()):
            raise ValueError(
                "eps_init must be at least eps_end and both be between 0 and 1, got "
                f"{start.tolist()} and {end.tolist()}"
            )
        super().__init__(
            spec,
            1.0,
            0.0,
            annealing_num_steps,
            action_key=action_key,
            action_mask_key=action_mask_key,
        )
        self.eps_init = start
        self.eps_end = end
        self.eps = start.clone()
        self.until_success = until_success
        self.register_buffer(
            "success", None if until_success is None else torch.zeros_like(self.eps)
        )

    def step(self, frames: int = 1) -> None:
        """Lowers epsilon by ``frames`` steps of the schedule; nothing with ``until_success``."""
        if self.until_success is None:
            super().step(frames)

    def see_success(self, success_rate: Tensor) -> None:
        """Sets epsilon by success, if so constructed; see :meth:`Boltzmann.see_success`."""
        if self.until_success is not None:
            falls = self.eps_init, self.eps_end, self.success
            self.eps.copy_(_fallen(*falls, success_rate, self.until_success))


class Boltzmann(TensorDictModuleBase):
    """Replaces the greedy action by a draw from softmax(Q / temperature).

    Place it after an actor. It explores under RANDOM and outside of any context, otherwise it
    leaves the action unchanged. The temperature falls linearly, with :meth:`step` or with the
    replica's success (:meth:`see_success`), and is a buffer, so checkpoints include it.

    Args:
        temperature_init: initial temperature in units of Q (rewards): a number, or a tensor that
            broadcasts with the batch, such as [*replicas, 1] for one per replica.
        temperature_end: temperature after ``annealing_num_steps`` steps, likewise.
        annealing_num_steps: length of the schedule.

    Keyword Args:
        action_key: the key of the greedy action, which is replaced. The drawn action is one-hot
            [*batch, N] if the greedy one is, otherwise (and without one) an index [*batch].
        action_value_key: values [*batch, N].
        action_mask_key: bool [*batch, N], or None for no mask.
        until_success: the mean success at which the schedule ends. It then falls with success and
            not with :meth:`step`; its start or end must have shape [replicas, 1]. Defaults to None.

    Raises:
        ValueError: unless temperature_init ≥ temperature_end > 0 and the schedule has a step.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> explore = Boltzmann(2.0, 0.5, 3, action_mask_key=None)
        >>> td = TensorDict(action_value=torch.tensor([[0.0, 99.0, -99.0]]), batch_size=[1])
        >>> explore(td)["action"]
        tensor([1])
        >>> explore.step(2)
        >>> explore.temperature
        tensor(1.)
    """

    temperature: Tensor
    temperature_init: Tensor
    temperature_end: Tensor
    success: Tensor

    def __init__(
        self,
        temperature_init: float | Tensor,
        temperature_end: float | Tensor,
        annealing_num_steps: int = 1000,
        *,
        action_key: NestedKey = "action",
        action_value_key: NestedKey = "action_value",
        action_mask_key: NestedKey | None = "action_mask",
        until_success: float | None = None,
    ) -> None:
        start, end = schedule(temperature_init, temperature_end, annealing_num_steps)
        if not bool(((start >= end) & (end > 0)).all()):
            raise ValueError(
                "temperature_init must be at least temperature_end and both must be positive, got "
                f"{start.tolist()} and {end.tolist()}"
            )
        super().__init__()
        self.action_key = action_key
        self.action_value_key = action_value_key
        self.action_mask_key = action_mask_key
        self.in_keys = [action_value_key]
        if action_mask_key is not None:
            self.in_keys.append(action_mask_key)
        self.out_keys = [action_key]
        self.annealing_num_steps = annealing_num_steps
        self.register_buffer("temperature_init", start)
        self.register_buffer("temperature_end", end)
        self.register_buffer("temperature", start.clone())
        self.until_success = until_success
        if until_success is not None:
            self.register_buffer("success", torch.zeros_like(self.temperature))

    def step(self, frames: int = 1) -> None:
        """Lowers the temperature by ``frames`` steps; nothing with ``until_success``."""
        if self.until_success is None:
            fall = (self.temperature_init - self.temperature_end) / self.annealing_num_steps
            self.temperature.copy_(
                torch.maximum(self.temperature_end, self.temperature - frames * fall)
            )

    def see_success(self, success_rate: Tensor) -> None:
        """Sets the temperature by a running mean of success; nothing without ``until_success``.

        Args:
            success_rate: the share of the round's dialogues that succeeded, [replicas]. It has
                weight .2 in the mean, which starts at 0.
        """
        if self.until_success is not None:
            falls = self.temperature_init, self.temperature_end, self.success
            self.temperature.copy_(_fallen(*falls, success_rate, self.until_success))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the drawn action in the form of the greedy one."""
        if not explores():
            return tensordict
        # values have one more dimension than the batch
        temperature = self.temperature.expand(tensordict.batch_size).unsqueeze(-1)
        logits = tensordict.get(self.action_value_key).detach() / temperature
        # argmax(logit - log E), E ~ Exp(1), is a draw from the softmax (the Gumbel trick)
        logits = logits - torch.empty_like(logits).exponential_().log_()
        mask = legal_actions(tensordict, self.action_mask_key)
        if mask is not None:
            logits = torch.where(mask, logits, float("-inf"))
        action, greedy = logits.argmax(-1), tensordict.get(self.action_key, None)
        if greedy is not None and greedy.shape == logits.shape:
            action = torch.zeros_like(greedy).scatter_(-1, action.unsqueeze(-1), 1)
        return tensordict.set(self.action_key, action)
