"""The Gaussian posterior: its KL and gradients against torch.distributions and autograd."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from torch.distributions import Normal, kl_divergence

from bbq_torchrl.bayes import GaussianPosterior, weight_scope
from bbq_torchrl.bayes.posterior import inverse_softplus

REPLICAS = [(), (3,), (2, 2)]


def posterior_with(replicas=(), groups=(40, 21), prior_std=(0.1, 0.7), dtype=torch.double):
    """A posterior at random means and spreads."""
    posterior = GaussianPosterior(groups, prior_std, replicas=replicas, dtype=dtype)
    with torch.no_grad():
        posterior.mu.normal_(0, 0.5)
        posterior.rho.uniform_(-4, 2)
    return posterior


def naive(posterior, noise):
    """Returns draw, closed KL and sampled KL by autograd and torch.distributions."""
    sigma = torch.nn.functional.softplus(posterior.rho)
    q = Normal(posterior.mu, sigma)
    std = torch.nn.functional.softplus(posterior.prior_rho)
    if std.shape[-1] > 1:
        std = torch.cat([s.expand(n) for n, s in zip(posterior.group_sizes, std, strict=True)])
    p = Normal(torch.zeros_like(std), std)
    weights = posterior.mu + sigma * noise
    closed = kl_divergence(q, p).sum(-1)
    return weights, closed, (q.log_prob(weights) - p.log_prob(weights)).sum(-1)


def with_noise(posterior, noise):
    """Makes the posterior draw the given noise; its replicas come one after the other."""
    rows = iter(noise.reshape(-1, noise.shape[-1]))

    def fill(buffer):
        for row in buffer.reshape(-1, buffer.shape[-1]):
            row.copy_(next(rows))

    posterior.fill_noise_ = fill


CASES = [(replicas, (40, 21), std) for replicas in REPLICAS for std in ((0.1, 0.7), (0.3,))]
CASES += [
    ((3,), (7, 4), torch.tensor([0.05, 0.3, 1.7])),  # a prior for each replica
    ((2, 2), (7, 4), torch.tensor([[0.05, 0.3], [0.7, 2.0]])),
    # More weights than are worked on at a time.
    ((5,), (40_001,), torch.tensor([0.05, 0.1, 0.2, 0.4, 0.8])),
]


@pytest.mark.parametrize(("replicas", "groups", "prior_std"), CASES, ids=str)
@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_draw_kl_and_gradients_equal_naive_autograd(replicas, groups, prior_std, kind):
    posterior = posterior_with(replicas, groups, prior_std)
    noise = torch.randn_like(posterior.mu)
    with_noise(posterior, noise)
    reference = deepcopy(posterior)
    weights, kl = posterior.sample_with_kl(kind)
    expected_weights, closed, sampled = naive(reference, noise)
    expected_kl = closed if kind == "closed" else sampled
    torch.testing.assert_close(posterior.kl(), closed)
    torch.testing.assert_close(weights, expected_weights)
    torch.testing.assert_close(kl, expected_kl)
    probe, kl_probe = torch.randn_like(weights), torch.randn_like(kl)
    for outputs, expected, probes in [
        ((weights, kl), (expected_weights, expected_kl), (probe, kl_probe)),
        ((weights,), (expected_weights,), (probe,)),
        ((kl,), (expected_kl,), (kl_probe,)),
        ((posterior.kl(),), (closed,), (kl_probe,)),
    ]:
        ours = torch.autograd.grad(
            outputs, (posterior.mu, posterior.rho), probes, retain_graph=True
        )
        theirs = torch.autograd.grad(
            expected, (reference.mu, reference.rho), probes, retain_graph=True
        )
        torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("prior_std", [1e-3, 0.3, 1.0, 30.0, torch.tensor([0.05, 1.7])], ids=str)
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
# 37: full vectors and a remainder; softplus may round differently in the two
@pytest.mark.parametrize("numel", [1, 37, 1000])
def test_at_the_prior_the_closed_kl_has_a_gradient_of_exactly_zero(prior_std, dtype, numel):
    posterior = GaussianPosterior([numel], prior_std, replicas=(2,), dtype=dtype)
    _, kl = posterior.sample_with_kl()
    for value in (kl, posterior.kl()):
        assert value.abs().max() < 1e-5 * numel
        for grad in torch.autograd.grad(value.sum(), (posterior.mu, posterior.rho)):
            assert not grad.any()


def test_at_the_prior_the_gradient_stays_zero_when_the_dtype_changes():
    posterior = GaussianPosterior([100, 50], (0.1, 0.3)).double()
    posterior.kl().backward()
    assert not posterior.mu.grad.any()
    assert not posterior.rho.grad.any()


def test_near_the_prior_the_kl_is_not_rounded_away():
    # 100,000 weights whose KL is about 1e-9 each: a difference of sums of 1e5 would lose it
    posterior = GaussianPosterior([100_000], 0.1)
    exact = GaussianPosterior([100_000], 0.1, dtype=torch.double)
    with torch.no_grad():
        posterior.rho.add_(3e-5 * torch.randn_like(posterior.rho))
        posterior.mu.normal_(0, 3e-6)
        exact.rho.copy_(posterior.rho)
        exact.mu.copy_(posterior.mu)
        exact.prior_rho.copy_(posterior.prior_rho)
    assert abs(posterior.kl() - exact.kl()) < 2e-3


@pytest.mark.parametrize("rho", [-1000.0, -120.0, -60.0, -20.0, -5.0, 5.0, 20.0, 60.0, 1000.0])
@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_extreme_rho_gives_finite_values_and_gradients(rho, kind):
    posterior = GaussianPosterior([11, 6], (0.1, 3.0))
    with torch.no_grad():
        posterior.rho.fill_(rho)
        posterior.mu.normal_()
    weights, kl = posterior.sample_with_kl(kind)
    (weights.sum() + kl + posterior.kl()).backward()
    for tensor in (weights, kl, posterior.kl(), posterior.mu.grad, posterior.rho.grad):
        assert tensor.isfinite().all()
    assert posterior.kl() > 0


def test_draws_have_the_posterior_mean_and_spread():
    posterior = posterior_with((2,), groups=(3, 2))
    draws = posterior.sample((20_000,))
    assert draws.shape == (2, 20_000, 5)
    sigma = posterior.sigma
    error = (draws.mean(1) - posterior.mu).abs() / (sigma / 20_000**0.5)
    assert error.max() < 5.5
    # the relative error of a standard deviation is (2n)^-.5 = .005
    assert ((draws.std(1) / sigma) - 1).abs().max() < 0.03


def test_a_draw_from_a_held_spread_has_a_gradient_in_the_mean_alone():
    posterior, held = posterior_with(()), {}
    with weight_scope(sigma=held):
        posterior.sample().sum().backward()
    assert bool((posterior.mu.grad == 1).all())
    assert posterior.rho.grad is None
    assert torch.equal(held[posterior], posterior.sigma)


@pytest.mark.parametrize("std", [1e-6, 0.1, 1.0, 50.0, 500.0])
def test_inverse_softplus_inverts_softplus(std):
    value = torch.tensor(std, dtype=torch.double)
    torch.testing.assert_close(torch.nn.functional.softplus(inverse_softplus(value)), value)


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_a_prior_std_that_is_none_is_refused(value):
    with pytest.raises(ValueError, match="prior_std must be positive and finite, got"):
        GaussianPosterior([3], value)
    with pytest.raises(ValueError, match="std_init must be positive and finite, got"):
        GaussianPosterior([3], 1.0).reset_std_(value)


def test_as_many_priors_as_groups_or_one():
    with pytest.raises(ValueError, match="one for each of the 3 groups, got 2"):
        GaussianPosterior([3, 4, 5], [0.1, 0.2])
    of_replicas = [torch.tensor([0.1, 0.2]), torch.tensor([0.3, 0.4])]
    with pytest.raises(ValueError, match=r"prior_std must be one number .*, got \[2\]"):
        GaussianPosterior([2, 2], of_replicas, replicas=2)


def test_another_kind_of_kl_is_refused():
    with pytest.raises(ValueError, match=r"kl must be one of \['closed', 'sampled'\], got 'mc'"):
        GaussianPosterior([3], 1.0).sample_with_kl("mc")
