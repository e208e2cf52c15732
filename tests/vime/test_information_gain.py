"""The information gain against per-sample gradients, the KL's Hessian, and the exact KL."""

from copy import deepcopy

import pytest
import torch
import torch.nn.functional as F
from q_transitions import REPLICAS, elements, plain_mlp
from torch.distributions import Normal
from torch.func import grad, vmap

from bbq_torchrl.vime import DynamicsModel, information_gain

NOISE_STD, STEP = 0.7, 0.03


def case(replicas=(), hidden=(6, 5), rows=(7,), dtype=torch.double):
    """A model at random weights whose states are standardized already, transitions, noise."""
    dynamics = DynamicsModel(3, 1, hidden, replicas=replicas, noise_std=NOISE_STD, dtype=dtype)
    posterior = dynamics.network.posterior
    with torch.no_grad():
        posterior.mu.normal_(0, 0.5)
        posterior.rho.uniform_(-4, 1)
    shape = (*replicas, *rows)
    transitions = tuple(torch.randn(*shape, size, dtype=dtype) for size in (3, 1, 3))
    return dynamics, transitions, torch.randn_like(posterior.mu)


def surprise(mu, rho, noise, x, target, layout):
    """-log p(target | x, w) of one transition, w = μ + σ ε; by its definition."""
    weights = mu + F.softplus(rho) * noise
    predicted = plain_mlp(x, layout.unflatten(weights))
    return -Normal(predicted, NOISE_STD).log_prob(target).sum()


def slopes(mu, rho, noise, x, target, layout):
    """The gradients of each transition's surprise, [rows, P] for μ and for ρ."""
    one = grad(lambda m, r, a, b: surprise(m, r, noise, a, b, layout), (0, 1))
    return vmap(one, (None, None, 0, 0))(mu, rho, x, target)


def divergence(mu, rho, at_mu, at_rho):
    """The KL of one weight's posterior from that at another place, plus 1/2."""
    sigma, at_sigma = F.softplus(rho), F.softplus(at_rho)
    return (at_sigma / sigma).log() + (sigma**2 + (mu - at_mu) ** 2) / (2 * at_sigma**2)


def curvature(mu, rho):
    """The diagonal of the KL's Hessian at the point itself, for μ and for ρ."""
    of = (grad(grad(divergence, number), number) for number in (0, 1))
    return [vmap(one)(mu, rho, mu, rho) for one in of]


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("hidden", [(), (6,), (6, 5)])
@pytest.mark.parametrize(("at", "rows"), [("map", (7,)), ("mc", (3, 4))])
def test_it_is_that_of_per_sample_gradients(replicas, hidden, at, rows):
    dynamics, (state, action, following), noise = case(replicas, hidden, rows)
    if at == "map":
        noise = torch.zeros_like(noise)
    given = None if at == "map" else noise
    gain = information_gain(dynamics, state, action, following, noise=given, step_size=STEP)
    assert gain.shape == (*replicas, *rows)
    assert not gain.requires_grad
    posterior, x = dynamics.network.posterior, torch.cat([state, action], -1)
    weights = (posterior.mu.detach(), posterior.rho.detach(), noise)
    each = zip(*(elements(t, replicas) for t in (*weights, x, following, gain)), strict=True)
    for mu, rho, epsilon, x, target, found in each:
        states = x.flatten(0, -2), target.flatten(0, -2)
        by_mu, by_rho = slopes(mu, rho, epsilon, *states, dynamics.network.layout)
        of_mu, of_rho = curvature(mu, rho)
        expected = (by_mu.square() / of_mu + by_rho.square() / of_rho).sum(-1)
        expected *= 0.5 * STEP**2
        torch.testing.assert_close(found.flatten(), expected, rtol=1e-10, atol=0)


@pytest.mark.parametrize("at", ["map", "mc"])
@pytest.mark.parametrize("rho", [-1e4, -200.0, -100.0, -20.0, 20.0, 100.0, 1e4])
def test_it_is_finite_for_every_width(at, rho):
    dynamics, transitions, noise = case(dtype=torch.float)
    with torch.no_grad():
        dynamics.network.posterior.rho.fill_(rho)
    gain = information_gain(dynamics, *transitions, noise=None if at == "map" else noise.abs())
    assert gain.isfinite().all()
    assert (gain >= 0).all()


def test_it_is_that_of_standardized_states():
    dynamics, (before, action, after), _ = case((2,), rows=(8,))
    plain = deepcopy(dynamics)
    before, after = 4 + 3 * before, 4 + 3 * after
    dynamics.update_statistics(before)
    z = [(t - before.mean(1, True)) / before.std(1, False, keepdim=True) for t in (before, after)]
    gain = information_gain(dynamics, before, action, after)
    expected = information_gain(plain, z[0], action, z[1])
    torch.testing.assert_close(gain, expected, rtol=1e-8, atol=0)


def test_shapes_that_do_not_fit_are_named():
    dynamics, (state, action, following), noise = case((2,))
    with pytest.raises(ValueError, match="next_observation"):
        information_gain(dynamics, state, action, following[:, :6])
    with pytest.raises(ValueError, match="noise"):
        information_gain(dynamics, state, action, following, noise=noise[0])


def test_no_rows_have_no_gain():
    dynamics, transitions, _ = case((2,), rows=(0,))
    assert information_gain(dynamics, *transitions).shape == (2, 0)
