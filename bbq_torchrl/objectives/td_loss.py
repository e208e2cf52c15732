"""Losses of the values at the actions taken: TD loss, with a hand-written gradient, and margin."""

from __future__ import annotations

from typing import Any, Literal, get_args

import torch
from torch import Tensor

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
