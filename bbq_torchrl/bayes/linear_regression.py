"""Bayesian linear regression in closed form, one for each action."""

from __future__ import annotations

import torch
from torch import Tensor


def posterior_factors(
    features: Tensor, action: Tensor, actions: int, prior_std: float, noise_std: float
) -> Tensor:
    """Returns F [A, M, M] with Fᵀ F = (I / p² + Σ φ φᵀ / σ²)⁻¹, each action's posterior covariance.

    The sum is over the action's rows. One Cholesky decomposition an action, in float64.

    Args:
        features: φ, shape [N, M].
        action: the action of each row, int64 [N].
        actions: the number A of actions.
        prior_std: standard deviation p of each weight's prior.
        noise_std: standard deviation σ of the targets' noise.

    Examples:
        >>> posterior_factors(torch.ones(3, 1), torch.zeros(3).long(), 2, 1.0, 1.0)
        tensor([[[0.5000]],
                [[1.0000]]])
    """
    size = features.shape[-1]
    one = torch.eye(size, dtype=features.dtype, device=features.device)
    counts = action.bincount(minlength=actions).tolist()
    factors = features.new_empty(actions, size, size)
    for number, rows in enumerate(features[action.argsort(stable=True)].split(counts)):
        precision = (rows.mT @ rows).double() / noise_std**2
        precision.diagonal().add_(prior_std**-2)
        root = torch.linalg.cholesky(precision).to(features)
        torch.linalg.solve_triangular(root, one, upper=False, out=factors[number])
    return factors


def posterior_means(
    factors: Tensor, features: Tensor, action: Tensor, target: Tensor, noise_std: float
) -> Tensor:
    """Returns the posterior means of each action's weights, [A, M], for a prior of mean 0.

    Args:
        factors: the output of :func:`posterior_factors`, [A, M, M].
        features: φ, shape [N, M].
        action: the action of each row, int64 [N].
        target: shape [N].
        noise_std: standard deviation of the targets' noise.
    """
    weights = target.new_zeros(len(factors), len(target))
    weights.scatter_(0, action.unsqueeze(0), (target / noise_std**2).unsqueeze(0))
    sums = weights @ features
    return (factors.mT @ (factors @ sums.unsqueeze(-1))).squeeze(-1)
