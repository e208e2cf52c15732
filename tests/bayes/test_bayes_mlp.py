"""Bayesian networks: settings, modes, gradients, starts, devices, the prior's spread of Q."""

import math

import numpy as np
import pytest
import torch
from q_transitions import off_prior

from bbq_torchrl.bayes import BayesMLP, GaussianPosterior


@pytest.mark.parametrize("replicas", [(), (3,), (2, 3)])
def test_its_modes_are_the_networks_of_the_means_and_of_one_draw(replicas):
    net, x = off_prior(BayesMLP(4, 3, (8, 8), replicas=replicas)), torch.randn(*replicas, 6, 4)
    assert torch.equal(net(x, "mean"), net(x, weights=net.posterior.mu))
    torch.manual_seed(0)
    weights = net.draw_weights()
    torch.manual_seed(0)
    assert torch.equal(net(x, "draw"), net(x, weights=weights))


@pytest.mark.parametrize("rho", [-60.0, 0.0, 20.0])
@pytest.mark.parametrize("inputs", [torch.zeros, torch.ones])
def test_local_reparameterization_has_finite_gradients(rho, inputs):
    # at zeros the spread of the first layer is the bias' alone, whose square root is taken
    net = BayesMLP(5, 3, (64, 64))
    with torch.no_grad():
        net.posterior.rho.fill_(rho)
    x = inputs(8, 5).requires_grad_()
    out = net(x, "local")
    gradients = torch.autograd.grad(out.square().mean(), [x, *net.parameters()])
    assert all(tensor.isfinite().all() for tensor in (out, *gradients))


def test_fan_in_prior_keeps_the_spread_of_q_at_the_scale_of_the_input():
    net = BayesMLP(268, 39, prior_std="fan_in", mean_init="zero", std_init=None)
    of_layers = torch.tensor([2 / 268, 2 / 256, 2 / 256]).sqrt()
    expected = of_layers.repeat_interleave(torch.tensor(net.layout.layer_sizes))
    torch.testing.assert_close(net.posterior.prior_std, expected)
    torch.testing.assert_close(net.posterior.sigma, expected)
    x = torch.zeros(268)
    x[:27] = 1.0
    variance = 2 / 268 * 28
    for width in (256, 256):
        variance = 2 / width * (width * variance / 2 + 1)
    spread = net(x.expand(200, 268), "local").square().mean().sqrt().item()
    assert spread == pytest.approx(variance**0.5, rel=0.05)


def test_it_starts_again_in_the_bounds_of_torch_linear_and_at_std_init():
    net = off_prior(BayesMLP(10, 3, (20,), replicas=(2,), mean_init="kaiming", std_init=0.03))
    net.reset_parameters()
    for matrix, bias in net.layout.unflatten(net.posterior.mu.detach()):
        bound = matrix.shape[-2] ** -0.5
        assert 0.5 * bound < matrix.abs().max() <= bound
        assert bias.abs().max() <= bound
    torch.testing.assert_close(net.posterior.sigma, torch.full_like(net.posterior.mu, 0.03))
    assert not torch.equal(net.posterior.mu[0], net.posterior.mu[1])


def test_a_network_starts_each_replica_at_its_std_init():
    stds = torch.tensor([0.01, 0.5])
    net = BayesMLP(3, 2, (4,), replicas=(2,), prior_std=stds, std_init=None)
    torch.testing.assert_close(net.posterior.sigma, stds[:, None].expand_as(net.posterior.rho))
    torch.testing.assert_close(net.posterior.prior_std, stds[:, None])
    started = BayesMLP(3, 2, (4,), replicas=(2,), std_init=stds)
    torch.testing.assert_close(started.posterior.sigma, net.posterior.sigma)
    by_fan_in = (2 / torch.tensor([3.0, 4.0])).sqrt()  # the default, with which Bayes' rule fits
    torch.testing.assert_close(started.posterior.prior_std[[0, -1]], by_fan_in)


@pytest.mark.parametrize("replicas", [3, (3,), np.int64(3), [np.int64(3)], torch.tensor(3)])
def test_any_integer_is_a_number_of_replicas(replicas):
    assert BayesMLP(3, 2, replicas=replicas).replicas == torch.Size([3])


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("prior_std", lambda: BayesMLP(3, 2, prior_std=math.inf)),
        ("std_init", lambda: BayesMLP(3, 2, std_init=torch.tensor([0.5, math.nan]), replicas=2)),
        ("mean_init", lambda: BayesMLP(3, 2, mean_init=0.0)),
        ("prior_std", lambda: BayesMLP(3, 2, (), prior_std=torch.ones(3), replicas=2)),
        ("prior_std", lambda: GaussianPosterior([3, 4, 5], [0.1, 0.2])),
        ("prior_std", lambda: GaussianPosterior([2, 2], [torch.ones(2)] * 2, replicas=2)),
        ("kl", lambda: GaussianPosterior([3], 1.0).sample_with_kl("mc")),
        ("local", lambda: GaussianPosterior([3], 1.0).weights("local")),
    ],
)
def test_what_is_no_network_is_refused(key, wrong):
    with pytest.raises(ValueError, match=key):
        wrong()
