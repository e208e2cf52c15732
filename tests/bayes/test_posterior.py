"""The Gaussian posterior: its KL and gradients against torch.distributions and autograd."""

import pytest
import torch
from torch.distributions import Normal, kl_divergence
from torch.nn.functional import softplus

from bbq_torchrl.bayes import GaussianPosterior, weight_scope


def posterior_with(replicas=(), groups=(40, 21), prior_std=(0.1, 0.7)):
    """A posterior at random means and spreads."""
    posterior = GaussianPosterior(groups, prior_std, replicas=replicas, dtype=torch.double)
    with torch.no_grad():
        posterior.mu.normal_(0, 0.5)
        posterior.rho.uniform_(-4, 2)
    return posterior


def naive(posterior, noise):
    """Returns draw, closed KL and sampled KL by autograd and torch.distributions."""
    q = Normal(posterior.mu, softplus(posterior.rho))
    std = softplus(posterior.prior_rho)
    if std.shape[-1] > 1:
        std = std.repeat_interleave(torch.tensor(posterior.group_sizes))
    p = Normal(torch.zeros_like(std), std)
    weights = q.loc + q.scale * noise
    sampled = q.log_prob(weights) - p.log_prob(weights)
    return weights, kl_divergence(q, p).sum(-1), sampled.sum(-1)


SEVERAL = torch.tensor([0.05, 0.1, 0.2, 0.4, 0.8])


@pytest.mark.parametrize(
    ("replicas", "groups", "prior_std"),
    [
        ((), (40, 21), (0.1, 0.7)),
        ((3,), (40, 21), (0.1, 0.7)),
        ((2, 2), (40, 21), (0.1, 0.7)),
        ((), (40, 21), (0.3,)),
        ((3,), (7, 4), SEVERAL[:3]),  # a prior for each replica
        ((2, 2), (7, 4), SEVERAL[:4].view(2, 2)),
        ((5,), (40_001,), SEVERAL),  # more weights than are worked on at a time
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_draw_kl_and_gradients_equal_naive_autograd(drawn_noise, replicas, groups, prior_std, kind):
    posterior = posterior_with(replicas, groups, prior_std)
    weights, kl = posterior.sample_with_kl(kind)
    noise = torch.cat(drawn_noise).view_as(posterior.mu)
    naive_weights, closed, sampled = naive(posterior, noise)
    naive_kl = closed if kind == "closed" else sampled
    probe, kl_probe = torch.randn_like(weights), torch.randn_like(kl)
    for ours, theirs, probes in [
        ((weights, kl), (naive_weights, naive_kl), (probe, kl_probe)),
        ((weights,), (naive_weights,), (probe,)),
        ((kl,), (naive_kl,), (kl_probe,)),
        ((posterior.kl(),), (closed,), (kl_probe,)),
    ]:
        torch.testing.assert_close(ours, theirs)
        gradients, expected = (
            torch.autograd.grad(outs, (posterior.mu, posterior.rho), probes, retain_graph=True)
            for outs in (ours, theirs)
        )
        torch.testing.assert_close(gradients, expected)


@pytest.mark.parametrize("prior_std", [1e-3, 0.3, 1.0, 30.0, SEVERAL[:2], (0.1, 0.3)], ids=str)
@pytest.mark.parametrize("made_in", [torch.float, torch.double])
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
# 37: full vectors and a remainder; softplus may round differently in the two
@pytest.mark.parametrize("numel", [1, 37, 1000])
def test_at_the_prior_the_closed_kl_has_a_gradient_of_exactly_zero(
    prior_std, made_in, dtype, numel
):
    posterior = GaussianPosterior([numel, 50], prior_std, replicas=(2,), dtype=made_in).to(dtype)
    _, kl = posterior.sample_with_kl()
    for value in (kl, posterior.kl()):
        assert value.abs().max() < 1e-5 * (numel + 50)
        for grad in torch.autograd.grad(value.sum(), (posterior.mu, posterior.rho)):
            assert not grad.any()


def test_near_the_prior_the_kl_is_not_rounded_away():
    # 100,000 weights whose KL is about 1e-9 each: a difference of sums of 1e5 would lose it
    posterior = GaussianPosterior([100_000], 0.1)
    exact = GaussianPosterior([100_000], 0.1, dtype=torch.double)
    with torch.no_grad():
        posterior.rho.add_(3e-5 * torch.randn_like(posterior.rho))
        posterior.mu.normal_(0, 3e-6)
    exact.load_state_dict(posterior.state_dict())
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


def test_a_draw_with_a_cached_spread_has_a_gradient_in_the_mean_alone():
    posterior, cache = posterior_with(), {}
    with weight_scope("draw", sigma=cache):
        posterior.weights().sum().backward()
    assert bool((posterior.mu.grad == 1).all())
    assert posterior.rho.grad is None
    assert torch.equal(cache[posterior], posterior.sigma)
