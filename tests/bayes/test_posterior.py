"""The Gaussian posterior: its KL and gradients against torch.distributions and autograd."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from torch.distributions import Normal, kl_divergence

from bbq_torchrl.bayes import GaussianPosterior
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
    std = torch.cat(
        [
            torch.full((n,), float(torch.nn.functional.softplus(r)), dtype=noise.dtype)
            for n, r in zip(posterior.group_sizes, posterior.prior_rho, strict=True)
        ]
    )
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


@pytest.mark.parametrize("replicas", REPLICAS)
def test_closed_kl_is_that_of_torch_distributions(replicas):
    posterior = posterior_with(replicas)
    _, closed, _ = naive(posterior, torch.zeros_like(posterior.mu))
    torch.testing.assert_close(posterior.kl(), closed)
    torch.testing.assert_close(posterior.sample_with_kl()[1], closed)


def test_closed_kl_is_the_mean_of_the_sampled_one():
    posterior = posterior_with(groups=(5, 4))
    closed = posterior.kl().detach()
    sampled = torch.stack([posterior.sample_with_kl("sampled")[1].detach() for _ in range(4000)])
    error = sampled.std() / 4000**0.5
    assert abs(sampled.mean() - closed) < 5 * error


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("kind", ["closed", "sampled"])
@pytest.mark.parametrize("prior_std", [(0.1, 0.7), (0.3,)])
def test_draw_kl_and_gradients_equal_naive_autograd(replicas, kind, prior_std):
    posterior = posterior_with(replicas, prior_std=prior_std)
    if len(prior_std) == 1:
        posterior.prior_rho.resize_(1)
    noise = torch.randn_like(posterior.mu)
    with_noise(posterior, noise)
    reference = deepcopy(posterior)
    reference.prior_rho = reference.prior_rho.expand(2).clone()
    weights, kl = posterior.sample_with_kl(kind)
    expected_weights, *kls = naive(reference, noise)
    expected_kl = kls[kind == "sampled"]
    torch.testing.assert_close(weights, expected_weights)
    torch.testing.assert_close(kl, expected_kl)
    probe, kl_probe = torch.randn_like(weights), torch.randn_like(kl)
    for outputs, expected, probes in [
        ((weights, kl), (expected_weights, expected_kl), (probe, kl_probe)),
        ((weights,), (expected_weights,), (probe,)),
        ((kl,), (expected_kl,), (kl_probe,)),
    ]:
        ours = torch.autograd.grad(
            outputs, (posterior.mu, posterior.rho), probes, retain_graph=True
        )
        theirs = torch.autograd.grad(
            expected, (reference.mu, reference.rho), probes, retain_graph=True
        )
        torch.testing.assert_close(ours, theirs)


def test_gradient_of_the_closed_kl_alone_equals_naive_autograd():
    posterior = posterior_with((3,))
    _, closed, _ = naive(posterior, torch.zeros_like(posterior.mu))
    parameters = (posterior.mu, posterior.rho)
    torch.testing.assert_close(
        torch.autograd.grad(posterior.kl().sum(), parameters),
        torch.autograd.grad(closed.sum(), parameters),
    )


@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_gradcheck_of_draw_and_kl(kind):
    posterior = posterior_with((2,), groups=(4, 3))

    def draw(mu, rho):
        torch.manual_seed(0)
        return torch.func.functional_call(
            _Drawing(posterior, kind), {"posterior.mu": mu, "posterior.rho": rho}, ()
        )

    assert torch.autograd.gradcheck(draw, (posterior.mu, posterior.rho))
    assert torch.autograd.gradcheck(
        lambda mu, rho: torch.func.functional_call(
            _Drawing(posterior, "kl"), {"posterior.mu": mu, "posterior.rho": rho}, ()
        ),
        (posterior.mu, posterior.rho),
    )


class _Drawing(torch.nn.Module):
    def __init__(self, posterior, kind):
        super().__init__()
        self.posterior, self.kind = posterior, kind

    def forward(self):
        if self.kind == "kl":
            return self.posterior.kl()
        return self.posterior.sample_with_kl(self.kind)


@pytest.mark.parametrize("prior_std", [1e-3, 0.1, 0.3, 1.0, 7.7, 30.0])
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


def test_the_kl_pulls_a_vanishing_spread_back():
    posterior = GaussianPosterior([8], 0.1, dtype=torch.double)
    with torch.no_grad():
        posterior.rho.fill_(-20.0)
    posterior.kl().backward()
    # d/dρ of -log σ is -1 where σ = e^ρ
    torch.testing.assert_close(posterior.rho.grad, torch.full_like(posterior.rho, -1.0))


def test_draws_have_the_posterior_mean_and_spread():
    posterior = posterior_with((2,), groups=(3, 2))
    draws = posterior.sample((20_000,))
    assert draws.shape == (2, 20_000, 5)
    sigma = posterior.sigma
    error = (draws.mean(1) - posterior.mu).abs() / (sigma / 20_000**0.5)
    assert error.max() < 5.5
    # the relative error of a standard deviation is (2n)^-.5 = .005
    assert ((draws.std(1) / sigma) - 1).abs().max() < 0.03


def test_draws_are_differentiable_and_independent():
    posterior = posterior_with(groups=(3, 2))
    draws = posterior.sample((4,))
    assert torch.unique(draws[:, 0]).numel() == 4
    draws.sum().backward()
    torch.testing.assert_close(posterior.mu.grad, torch.full_like(posterior.mu, 4.0))
    assert posterior.rho.grad.abs().min() > 0


@pytest.mark.parametrize("std", [1e-6, 0.1, 1.0, 50.0, 500.0])
def test_inverse_softplus_inverts_softplus(std):
    value = torch.tensor(std, dtype=torch.double)
    torch.testing.assert_close(torch.nn.functional.softplus(inverse_softplus(value)), value)


def test_changing_one_replica_leaves_the_others_gradient_bits_alone():
    def gradients(spoil):
        torch.manual_seed(0)
        posterior = posterior_with((3,), groups=(1000, 501), dtype=torch.float)
        if spoil:
            with torch.no_grad():
                posterior.mu[0] = float("nan")
                posterior.rho[0] = 3.0
        torch.manual_seed(1)
        weights, kl = posterior.sample_with_kl()
        (weights.square().sum() + (kl * 0.1).sum()).backward()
        return posterior.mu.grad, posterior.rho.grad

    for plain, spoilt in zip(gradients(False), gradients(True), strict=True):
        assert torch.equal(plain[1:], spoilt[1:])
        assert not torch.equal(plain[0], spoilt[0])


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_a_prior_std_that_is_none_is_refused(value):
    with pytest.raises(ValueError, match="prior_std must be positive and finite, got"):
        GaussianPosterior([3], value)
    with pytest.raises(ValueError, match="std_init must be positive and finite, got"):
        GaussianPosterior([3], 1.0).reset_std_(value)


def test_as_many_priors_as_groups_or_one():
    with pytest.raises(ValueError, match="one for each of the 3 groups, got 2"):
        GaussianPosterior([3, 4, 5], [0.1, 0.2])


def test_another_kind_of_kl_is_refused():
    with pytest.raises(ValueError, match=r"kl must be one of \['closed', 'sampled'\], got 'mc'"):
        GaussianPosterior([3], 1.0).sample_with_kl("mc")
