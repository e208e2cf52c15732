"""The large-margin loss, by which values learn to prefer demonstrated actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.networks.q_actor import masked

if TYPE_CHECKING:
    from torch import Tensor


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
