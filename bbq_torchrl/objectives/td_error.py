"""The loss of the values at the actions taken, with a hand-written gradient."""

from __future__ import annotations

from typing import Any, Literal, get_args

import torch
from torch import Tensor

__all__ = ["Distance", "td_loss"]

Distance = Literal["l2", "l1", "smooth_l1"]
DISTANCES: tuple[str, ...] = get_args(Distance)


class _TDLoss(torch.autograd.Function):
    """values [L, B, N] to the loss [L], the TD errors [L, B] and the chosen values [L, B]."""

    @staticmethod
    def forward(
        ctx: Any,
        values: Tensor,
        index: Tensor,
        target: Tensor,
        weight: Tensor | None,
        distance: Distance,
        scale: float,
    ) -> tuple[Tensor, Tensor, Tensor]:
        chosen = values.gather(-1, index).squeeze(-1)
        error = chosen - target
        if weight is None:
            slope_scale = scale / error.shape[-1]
        else:
            # Select, then multiply: a row that does not count may hold anything.
            ignored = weight == 0
            error = error.masked_fill_(ignored, 0)
            chosen = chosen.masked_fill_(ignored, 0)
            slope_scale = scale
        if distance == "l2":
            rows, slope = error.square(), error * (2 * slope_scale)
        elif distance == "l1":
            rows, slope = error.abs(), error.sign() * slope_scale
        else:
            slope = error.clamp(-1, 1)
            rows = slope * (error - 0.5 * slope)
            slope = slope * slope_scale
        if weight is not None:
            rows, slope = rows * weight, slope * weight
        ctx.save_for_backward(index, slope)
        ctx.shape = values.shape
        ctx.mark_non_differentiable(error, chosen)
        ctx.set_materialize_grads(False)
        return rows.sum(-1).mul_(slope_scale), error, chosen

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor | None, *_: Any) -> tuple[Tensor | None, ...]:
        if grad is None:
            return None, None, None, None, None, None
        index, slope = ctx.saved_tensors
        slope = (slope * grad.unsqueeze(-1)).unsqueeze(-1)
        out = slope.new_zeros(ctx.shape).scatter_(-1, index, slope)
        return out, None, None, None, None, None


def td_loss(
    values: Tensor,
    index: Tensor,
    target: Tensor,
    weight: Tensor | None = None,
    distance: Distance = "l2",
    scale: float = 1.0,
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns each network's loss, its TD errors and the values of the actions taken.

    Args:
        values: Q, shape [*stack, B, N].
        index: actions, int64, shape [*stack, B, 1].
        target: what the chosen values should be, shape [*stack, B]; gets no gradient.
        weight: of each row, [*stack, B], adding up to 1 over a batch; None for 1/B each. Rows
            of weight 0 may hold anything, NaN too.
        distance: "l2" (squared), "l1" or "smooth_l1" (as ``torch.nn``'s, β = 1).
        scale: factor of the loss.

    Returns:
        the loss [*stack], Σ weight · scale · distance(Q(s, a) - target), differentiable in
        values; and without gradients Q(s, a) - target and Q(s, a), each [*stack, B] and 0 in
        rows of weight 0.

    Example:
        >>> import torch
        >>> values = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
        >>> td_loss(values, torch.tensor([[1], [0]]), torch.tensor([0.0, 0.0]))
        (tensor(6.5000), tensor([2., 3.]), tensor([2., 3.]))
    """
    out: tuple[Tensor, Tensor, Tensor] = _TDLoss.apply(
        values, index, target, weight, distance, scale
    )
    return out
