"""The information gain against per-sample gradients, the KL's Hessian, and the exact KL."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from torch.distributions import Normal, kl_divergence
from torch.func import grad, vmap

from bbq_torchrl.bayes.functional import FlatLayout
from bbq_torchrl.vime import DynamicsModel, information_gain, mlp_information_gain

REPLICAS = [(), (1,), (3,), (2, 2)]
NOISE_STD, STEP = 0.7, 0.03


def case(replicas=(), sizes=(4, 6, 5, 3), rows=(7,), dtype=torch.double):
    """Random networks, transitions and weight noise."""
    layout = FlatLayout(sizes)
    shape = (*replicas, layout.numel)
    mu = 0.5 * torch.randn(shape, dtype=dtype)
    rho = torch.empty(shape, dtype=dtype).uniform_(-4, 1)
    x = torch.randn(*replicas, *rows, sizes[0], dtype=dtype)
    target = torch.randn(*replicas, *rows, sizes[-1], dtype=dtype)
    return layout, mu, rho, x, target, torch.randn(shape, dtype=dtype)


def surprise(mu, rho, noise, x, target, layout):
    """-log p(target | x, w) of one transition, w = μ + σ ε; by its definition."""
    weights = mu + F.softplus(rho) * noise
    for k, (matrix, bias) in enumerate(layout.unflatten(weights)):
        x = (x if k == 0 else x.relu()) @ matrix + bias
    return -Normal(x, NOISE_STD).log_prob(target).sum()


def slopes(mu, rho, noise, x, target, layout):
    """The gradients of each transition's surprise, [rows, P] for μ and for ρ."""
    one = grad(lambda m, r, a, b: surprise(m, r, noise, a, b, layout), (0, 1))
    return vmap(one, (None, None, 0, 0))(mu, rho, x, target)


def curvature(rho):
    """The Hessian of the KL at the point itself, for μ and for ρ; checked below."""
    sigma = F.softplus(rho)
    return sigma.square().reciprocal(), 2 * (torch.sigmoid(rho) / sigma).square()


def test_the_curvature_is_that_of_the_kl():
    mu, rho = torch.randn(5).double(), torch.empty(5).uniform_(-4, 1).double()
    q = Normal(mu, F.softplus(rho))

    def moved(both):
        return kl_divergence(Normal(both[0], F.softplus(both[1])), q).sum()

    hessian = torch.autograd.functional.hessian(moved, torch.stack([mu, rho])).reshape(10, 10)
    expected = torch.cat(curvature(rho))
    torch.testing.assert_close(hessian, torch.diag(expected), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("sizes", [(4, 3), (4, 6, 3), (4, 6, 5, 3)])
@pytest.mark.parametrize("at", ["map", "mc"])
def test_it_is_that_of_per_sample_gradients(replicas, sizes, at):
    layout, mu, rho, x, target, noise = case(replicas, sizes)
    if at == "map":
        noise = torch.zeros_like(noise)
    given = None if at == "map" else noise
    settings = {"noise_std": NOISE_STD, "step_size": STEP}
    gain = mlp_information_gain(x, target, mu, rho, layout, noise=given, **settings)
    assert gain.shape == (*replicas, 7)
    flat = [t.reshape(-1, *t.shape[len(replicas) :]) for t in (mu, rho, noise, x, target)]
    for k, element in enumerate(zip(*flat, strict=True)):
        by_mu, by_rho = slopes(*element, layout)
        of_mu, of_rho = curvature(element[1])
        expected = (by_mu.square() / of_mu + by_rho.square() / of_rho).sum(-1)
        expected *= 0.5 * STEP**2
        torch.testing.assert_close(gain.reshape(-1, 7)[k], expected, rtol=1e-10, atol=0)


def test_at_the_mean_it_is_the_exact_kl_of_a_natural_gradient_step():
    # only the means move, and the divergence is a quadratic function of them
    layout, mu, rho, x, target, noise = case(rows=(20,))
    by_mu, _ = slopes(mu, rho, torch.zeros_like(noise), x, target, layout)
    sigma = F.softplus(rho)
    after = Normal(mu - by_mu / curvature(rho)[0], sigma)
    gain = mlp_information_gain(x, target, mu, rho, layout, noise_std=NOISE_STD, step_size=1.0)
    exact = kl_divergence(after, Normal(mu, sigma)).sum(-1)
    torch.testing.assert_close(gain, exact, rtol=1e-6, atol=0)


@pytest.mark.parametrize("at", ["map", "mc"])
@pytest.mark.parametrize("rho", [-1e4, -200.0, -100.0, -20.0, 20.0, 100.0, 1e4])
def test_it_is_finite_for_every_width(at, rho):
    layout, mu, _, x, target, noise = case(dtype=torch.float)
    wide = torch.full_like(mu, rho)
    gain = mlp_information_gain(
        x, target, mu, wide, layout, noise=None if at == "map" else noise.abs()
    )
    assert gain.isfinite().all()
    assert (gain >= 0).all()


def test_it_is_the_dynamics_models_in_standardized_states():
    dynamics = DynamicsModel(3, 2, (6,), replicas=(2,), noise_std=NOISE_STD, dtype=torch.double)
    before, after = (4 + 3 * torch.randn(2, 8, 3, dtype=torch.double) for _ in range(2))
    action = torch.randint(2, (2, 8))
    dynamics.update_statistics(before)
    gain = information_gain(dynamics, before, action, after, step_size=STEP)
    assert not gain.requires_grad
    z = [(t - before.mean(1, True)) / before.std(1, False, keepdim=True) for t in (before, after)]
    x, net = torch.cat([z[0], F.one_hot(action, 2)], -1), dynamics.network
    settings = {"noise_std": NOISE_STD, "step_size": STEP}
    expected = mlp_information_gain(
        x, z[1], net.posterior.mu, net.posterior.rho, net.layout, **settings
    )
    torch.testing.assert_close(gain, expected, rtol=1e-8, atol=0)


def test_rows_may_have_any_shape():
    layout, mu, rho, x, target, _ = case((2,), rows=(3, 4))
    gain = mlp_information_gain(x, target, mu, rho, layout)
    flat = mlp_information_gain(x.flatten(1, 2), target.flatten(1, 2), mu, rho, layout)
    assert torch.equal(gain, flat.reshape(2, 3, 4))
    no_rows = mlp_information_gain(x[:, :0], target[:, :0], mu, rho, layout)
    assert no_rows.shape == (2, 0, 4)


def test_shapes_that_do_not_fit_are_named():
    layout, mu, rho, x, target, noise = case((2,))
    with pytest.raises(ValueError, match=r"target must have shape \[2, 7, 3\], got \[2, 6, 3\]"):
        mlp_information_gain(x, target[:, :6], mu, rho, layout)
    with pytest.raises(ValueError, match=r"x must have shape \[2, 7, 4\], got \[1, 7, 4\]"):
        mlp_information_gain(x[:1], target, mu, rho, layout)
    with pytest.raises(ValueError, match=r"noise must have shape \[2, 83\], got \[83\]"):
        mlp_information_gain(x, target, mu, rho, layout, noise=noise[0])
