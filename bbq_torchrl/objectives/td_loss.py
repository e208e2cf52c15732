"""Losses of the values at the actions taken, weights of a batch's rows, and the number of data N.

The TD loss has a hand-written gradient; N weighs a loss's KL.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.objectives import LossModule

from bbq_torchrl.bayes.functional import once_differentiable
from bbq_torchrl.bayes.noise import is_transformed
from bbq_torchrl.networks.q_actor import masked
from bbq_torchrl.settings import one_of

Distance = Literal["l2", "l1", "smooth_l1"]
DISTANCE = one_of(*get_args(Distance))


class _TDLoss(torch.autograd.Function):
    """Maps values [*replicas, B, N] to the outputs of :func:`td_loss`."""

    @staticmethod
    def forward(
        ctx: Any, values: Tensor, index: Tensor, *others: Any
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        loss, td_error, q_value, square, slope = _run(values, index, *others)
        ctx.save_for_backward(index, slope)
        ctx.shape = values.shape
        ctx.mark_non_differentiable(td_error, q_value, square)
        ctx.set_materialize_grads(False)
        return loss, td_error, q_value, square

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor | None, *_: Any) -> tuple[Tensor | None, ...]:
        if grad is None:  # the function of the loss has no gradient
            return None, None, None, None, None, None
        index, slope = ctx.saved_tensors
        slope = slope * grad[..., None, None]
        out = slope.new_zeros(ctx.shape).scatter_(-1, index, slope)
        return out, None, None, None, None, None


def _run(
    values: Tensor,
    index: Tensor,
    target: Tensor,
    weight: Tensor | None,
    distance: Distance,
    scale: float | Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Returns the outputs of :func:`td_loss`, and the loss's derivative by each chosen value."""
    total_scale = scale
    chosen = values.gather(-1, index)
    error = chosen - target
    if weight is None:
        scale = scale / max(1, error.shape[-2])
    else:
        # Mask before multiplying: an ignored row may contain anything.
        ignored = weight == 0
        chosen, error = chosen.masked_fill(ignored, 0), error.masked_fill(ignored, 0)
    square, size = error.square(), error.abs()
    if distance == "l2":
        rows, slope = square, error * _factor(2 * scale, error, 2)
    elif distance == "l1":
        rows, slope = size, error.sign() * _factor(scale, error, 2)
    else:
        clamped = error.clamp(-1, 1)
        rows, slope = clamped * (error - 0.5 * clamped), clamped * _factor(scale, error, 2)
    sums = torch.cat([rows, size, chosen], -1)
    if weight is None:
        means = sums.mean(-2) if sums.shape[-2] else sums.sum(-2)
        loss, td_error, q_value = means.unbind(-1)
    else:
        slope = slope * weight
        loss, td_error, q_value = (sums * weight).sum(-2).unbind(-1)
    return loss * _factor(total_scale, loss, 0), td_error, q_value, square, slope


def _factor(scale: float | Tensor, like: Tensor, dims: int) -> float | Tensor:
    """Returns a factor, a number or [*replicas], that broadcasts over ``dims`` more dimensions."""
    if not isinstance(scale, Tensor):
        return scale
    return scale.to(like.dtype).reshape(scale.shape + (1,) * dims)


def td_loss(
    values: Tensor,
    index: Tensor,
    target: Tensor,
    weight: Tensor | None = None,
    distance: Distance = "l2",
    scale: float | Tensor = 1.0,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns each network's loss, mean |TD error| and mean Q, and each row's squared TD error.

    Args:
        values: Q, shape [*replicas, B, N].
        index: actions, int64, shape [*replicas, B, 1].
        target: targets of the chosen values, shape [*replicas, B, 1]; gets no gradient.
        weight: row weights [*replicas, B, 1] that sum to 1 over a batch; None for 1/B each.
            Rows of weight 0 may contain anything, including NaN.
        distance: "l2" (squared), "l1" or "smooth_l1" (as ``torch.nn``'s, β = 1).
        scale: factor of the loss, one number or float64 [*replicas].

    Returns:
        the loss [*replicas], Σ weight · scale · distance(Q(s, a) - target), differentiable in
        values; and without gradients Σ weight · |Q(s, a) - target| and Σ weight · Q(s, a), each
        [*replicas], and (Q(s, a) - target)² [*replicas, B, 1], 0 in rows of weight 0. All sums
        of an empty batch are 0.

    Examples:
        >>> import torch
        >>> values = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
        >>> td_loss(values, torch.tensor([[1], [0]]), torch.zeros(2, 1))
        (tensor(6.5000), tensor(2.5000), tensor(2.5000), tensor([[4.], [9.]]))
    """
    if is_transformed():
        loss, *others, _ = _run(values, index, target.detach(), weight, distance, scale)
        td_error, q_value, square = (other.detach() for other in others)
        return loss, td_error, q_value, square
    out: tuple[Tensor, Tensor, Tensor, Tensor] = _TDLoss.apply(
        values, index, target, weight, distance, scale
    )
    return out


def margin_loss(
    values: Tensor,
    index: Tensor,
    legal: Tensor | None,
    demonstrated: Tensor,
    weight: Tensor | None,
    margin: float,
) -> Tensor:
    """Returns each network's large-margin loss (Hester et al. 2018, "DQfD", J_E), [*replicas].

    The mean over rows of max_a [Q(s, a) + m · 1(a ≠ a_E)] - Q(s, a_E), which is 0 if the
    demonstrated action a_E is ahead of all others by m, and 0 in rows that are no demonstrations.

    Args:
        values: Q, shape [*replicas, B, N].
        index: actions, int64, shape [*replicas, B, 1].
        legal: bool [*replicas, B, N], the actions to be ahead of; None for all.
        demonstrated: bool [*replicas, B, 1].
        weight: row weights [*replicas, B, 1] that sum to 1 over a batch; None for 1/B each.
        margin: m, in units of Q.

    Examples:
        >>> import torch
        >>> values, yes = torch.tensor([[1.0, 2.0], [3.0, 0.0]]), torch.ones(2, 1).bool()
        >>> margin_loss(values, torch.tensor([[0], [0]]), None, yes, None, 2.0)
        tensor(1.5000)
    """
    chosen = values.gather(-1, index)
    rivals = (values + margin).scatter(-1, index, chosen)
    behind = masked(rivals, legal).amax(-1, keepdim=True) - chosen
    behind = behind.where(demonstrated, 0)
    rows = max(1, values.shape[-2])
    return (behind / rows if weight is None else behind * weight).sum((-2, -1))


def row_entry(tensordict: TensorDictBase, key: NestedKey, rows: torch.Size) -> Tensor | None:
    """Returns an entry with one value per row as [*rows, 1]; None if it is missing.

    Args:
        tensordict: a batch.
        key: the key of the entry, [*rows] or [*rows, 1].
        rows: the batch shape.

    Raises:
        ValueError: for an entry of the wrong shape.
    """
    entry: Tensor | None = tensordict.get(key, None)
    if entry is None or entry.shape == (*rows, 1):
        return entry
    if entry.shape != rows:
        raise ValueError(f"{key!r} must have the batch shape {list(rows)}, got {list(entry.shape)}")
    return entry.unsqueeze(-1)


def valid_rows(loss: LossModule, tensordict: TensorDictBase, rows: torch.Size) -> Tensor | None:
    """Returns the mask of rows that a loss learns from, bool [*rows, 1]; None for all rows.

    The loss's ``loss_mask_key`` names the mask. If it is "auto", the mask combines "valid" (which
    the trainer's batches have) with the entries that TorchRL reads by default.

    Args:
        loss: the loss with the key.
        tensordict: a batch.
        rows: the batch shape.

    Raises:
        ValueError: for a mask of the wrong shape.
    """
    valid: Tensor | None = None
    ours = ("valid",) if loss.loss_mask_key == "auto" else ()
    for key in (*ours, *loss._loss_mask_keys()):
        mask = row_entry(tensordict, key, rows)
        if mask is not None:
            valid = mask.bool() if valid is None else valid & mask.bool()
    return valid


def row_weights(loss: LossModule, tensordict: TensorDictBase, rows: torch.Size) -> Tensor | None:
    """Returns the weight of each row, [*rows, 1]; None if all rows weigh the same.

    Weights are floating-point if prioritized replay has set any, otherwise bool.

    Args:
        loss: the loss with the keys of masks and prioritized weights.
        tensordict: a batch.
        rows: the batch shape.

    Raises:
        ValueError: for a mask or weights of the wrong shape.
    """
    valid = valid_rows(loss, tensordict, rows)
    if loss.use_prioritized_weights not in (True, "auto"):
        return valid
    priority = row_entry(tensordict, loss.tensor_keys.priority_weight, rows)
    if priority is None or valid is None:
        return valid if priority is None else priority
    return priority.where(valid, 0)


def normalized_weights(
    loss: LossModule, tensordict: TensorDictBase, reward: Tensor
) -> Tensor | None:
    """Returns weights [*replicas, *batch, 1] that sum to 1; None if all rows weigh the same.

    Args:
        loss: the loss with ``replicas`` and the keys of masks and prioritized weights.
        tensordict: a batch.
        reward: shape [*replicas, *batch, 1].

    Raises:
        ValueError: for a mask or weights of the wrong shape.
    """
    weight = row_weights(loss, tensordict, reward.shape[:-1])
    if weight is None:
        return None
    weight = weight.to(torch.result_type(reward, 1.0))  # rewards may be integers
    # 0 / tiny: the data of a replica without valid rows have no gradient
    tiny = torch.finfo(weight.dtype).tiny
    total = weight.sum(tuple(range(len(loss.replicas), reward.ndim)), keepdim=True)
    return weight / total.clamp_min_(tiny)


class NumData(nn.Module):
    """A mixin for losses with a KL / N: the buffer of N, [*replicas].

    List it before TorchRL's ``LossModule`` in the bases.
    """

    num_data: Tensor
    replicas: torch.Size

    def _register_num_data(self, num_data: int | Tensor | None, like: Tensor) -> None:
        """Registers the buffer, [*replicas], with the dtype and device of ``like``."""
        # 0 means unknown
        self.register_buffer("num_data", like.new_zeros(self.replicas))
        self._num_data_known = False
        if num_data is not None:
            self.set_num_data(num_data)

    def set_num_data(self, num_data: int | Tensor) -> None:
        """Sets N, the number of transitions that the KL is divided by.

        Args:
            num_data: a positive number or a tensor [*replicas].
        """
        self.num_data.copy_(torch.as_tensor(num_data))
        self._num_data_known = True

    def _check_num_data(self) -> None:
        """Raises RuntimeError if N is unknown."""
        if not self._num_data_known:
            raise RuntimeError(
                f"num_data is unknown: pass it to {type(self).__name__} or call "
                "set_num_data(n) with the number of transitions in the buffer"
            )

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, *args: Any, **kwargs: Any
    ) -> None:
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)
        loaded = state_dict.get(prefix + "num_data")
        if loaded is not None:
            self._num_data_known = bool((loaded > 0).all())
