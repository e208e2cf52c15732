"""Bayesian linear regression, where the best factorized Gaussian is known in closed form.

For y = x · w + noise the posterior is a Gaussian with precision Λ = XᵀX / noise_std² + I / p² and
mean Λ⁻¹Xᵀy / noise_std². Of all factorized Gaussians the one nearest to it (in the KL that the
evidence bound minimizes) has the same mean and the standard deviations Λ_ii^(-1/2), which are
smaller than the posterior's own.
"""

from __future__ import annotations

import pytest
import torch
from scipy.linalg import hadamard

from bbq_torchrl.bayes import BayesLinear, KLSum, weight_scope
from bbq_torchrl.bayes.noise import NoisePool

NOISE_STD, PRIOR_STD = 0.5, 1.0
ROWS, FEATURES, DRAWS = 32, 3, 512


def regression() -> tuple[torch.Tensor, torch.Tensor]:
    """Inputs [N, 3] and outputs [N]: features away from 0, so that weights and bias are correlated.

    The design is the same at each call: how slowly the flattest direction is learned depends on
    it. The noise is not.
    """
    mixing = torch.tensor([[1.0, 0.5, 0.0], [0.0, 0.8, 0.4], [0.0, 0.0, 0.9]]).double()
    orthogonal = torch.from_numpy(hadamard(ROWS)[:, 1 : FEATURES + 1]).double()
    x = orthogonal @ mixing + 0.3
    y = x @ torch.tensor([1.5, -1.0, 0.8]).double() + 2.0
    return x, y + NOISE_STD * torch.randn(ROWS, dtype=torch.double)


def optimum(x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Returns mean and standard deviation of the weights and, last, of the bias."""
    design = torch.cat([x, torch.ones_like(x[:, :1])], 1)
    precision = design.T @ design / NOISE_STD**2 + torch.eye(FEATURES + 1) / PRIOR_STD**2
    mean = torch.linalg.solve(precision, design.T @ y / NOISE_STD**2)
    return mean, precision.diagonal() ** -0.5


def learn(x, y, *, rows=None, num_data=ROWS, mode="draw", kl="closed", pooled=False, steps=200):
    """Returns mean and standard deviation of the weights that maximize the evidence bound.

    One network whose gradient is the average over draws (replicas of one network, each with a
    draw and a mini-batch of its own): one draw a step has the same optimum, later.
    """
    start = {"prior_std": PRIOR_STD, "mean_init": "zero", "std_init": 0.2}
    net = BayesLinear(FEATURES, 1, replicas=(DRAWS,), dtype=torch.double, **start)
    optimizer = torch.optim.Adam(net.parameters(), 0.1, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    pool = None
    for step in range(steps):
        if pooled and step % 10 == 0:
            pool = NoisePool()
        index = torch.arange(len(x)) if rows is None else torch.randint(len(x), (DRAWS, rows))
        kl_sum = KLSum(kl)
        with weight_scope(mode, noise=pool, kl=kl_sum):
            error = net(x[index].expand(DRAWS, -1, -1)).squeeze(-1) - y[index]
        # the loss of one transition, as BBQNLoss weighs it
        loss = error.square().mean(-1) / (2 * NOISE_STD**2) + kl_sum.total() / num_data
        optimizer.zero_grad()
        loss.sum().backward()
        for parameter in net.parameters():
            parameter.grad.copy_(parameter.grad.mean(0))
        optimizer.step()
        schedule.step()
    return net.posterior.mu.detach()[0], net.posterior.sigma.detach()[0]


def assert_optimal(found, expected):
    (mean, std), (expected_mean, expected_std) = found, expected
    torch.testing.assert_close(mean, expected_mean, rtol=0.05, atol=0)
    # far below the width of the posterior itself
    assert ((mean - expected_mean).abs() / expected_std).max() < 0.3
    torch.testing.assert_close(std, expected_std, rtol=0.05, atol=0)


@pytest.mark.parametrize(
    "settings",
    [
        {"mode": "draw"},
        {"mode": "draw", "kl": "sampled"},
        {"mode": "local", "rows": 8},
        {"mode": "draw", "rows": 8, "pooled": True},
    ],
    ids=["full", "full sampled KL", "batches local", "batches pool"],
)
def test_it_learns_the_best_factorized_gaussian(settings):
    data = regression()
    assert_optimal(learn(*data, **settings), optimum(*data))


def test_num_data_and_not_the_size_of_the_batch_weighs_the_prior():
    # 64 rows that are said to be 32 transitions have the weight of 32
    x, y = regression()
    assert_optimal(learn(x.repeat(2, 1), y.repeat(2), num_data=ROWS), optimum(x, y))
