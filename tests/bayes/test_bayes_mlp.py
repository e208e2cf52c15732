"""Bayesian networks: modes, draws, moments, the prior's spread of Q."""

from __future__ import annotations

import pytest
import torch
from torch.func import functional_call
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.bayes import BayesLinear, BayesMLP, weight_scope
from bbq_torchrl.bayes.noise import NoisePool
from bbq_torchrl.bayes.scope import current_scope, resolve_weight_mode

REPLICAS = [(), (3,), (2, 3)]


def trained(net):
    """Gives the posterior means and spreads away from the prior."""
    with torch.no_grad():
        net.posterior.mu.normal_(0, 0.3)
        net.posterior.rho.uniform_(-3, 0)
    return net


@pytest.mark.parametrize("replicas", REPLICAS)
def test_its_modes_are_the_networks_of_the_means_and_of_one_draw(replicas):
    net, x = trained(BayesMLP(4, 3, (8, 8), replicas=replicas)), torch.randn(*replicas, 6, 4)
    assert torch.equal(net(x, "mean"), net(x, weights=net.posterior.mu))
    torch.manual_seed(0)
    weights = net.draw_weights()
    torch.manual_seed(0)
    assert torch.equal(net(x, "draw"), net(x, weights=weights))


@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
@pytest.mark.parametrize("replicas", [(), (2,)])
def test_gradcheck_in_every_mode(mode, replicas):
    net = trained(BayesMLP(3, 2, (4,), replicas=replicas, dtype=torch.double))
    x = torch.randn(*replicas, 5, 3, dtype=torch.double, requires_grad=True)

    def call(x, mu, rho):
        torch.manual_seed(0)
        parameters = {"posterior.mu": mu, "posterior.rho": rho}
        return functional_call(net, parameters, (x, mode))

    assert torch.autograd.gradcheck(call, (x, net.posterior.mu, net.posterior.rho))


def test_fan_in_prior_keeps_the_spread_of_q_at_the_scale_of_the_input():
    net = BayesMLP(268, 39, prior_std="fan_in")
    torch.testing.assert_close(
        torch.nn.functional.softplus(net.posterior.prior_rho),
        torch.tensor([2 / 268, 2 / 256, 2 / 256]).sqrt(),
    )
    torch.testing.assert_close(net.posterior.sigma, net.posterior.prior_std.expand(144_679))
    x = torch.zeros(268)
    x[:27] = 1.0
    variance = 2 / 268 * 28
    for width in (256, 256):
        variance = 2 / width * (width * variance / 2 + 1)
    spread = net(x.expand(200, 268), "local").square().mean().sqrt().item()
    assert spread == pytest.approx(variance**0.5, rel=0.05)


def test_starts():
    net = BayesMLP(10, 3, (20,), prior_std=0.3)
    assert not net.posterior.mu.any()
    torch.testing.assert_close(net.posterior.sigma, torch.full_like(net.posterior.mu, 0.3))
    net = BayesMLP(10, 3, (20,), replicas=(2,), mean_init="kaiming", std_init=0.03)
    for matrix, bias in net.layout.unflatten(net.posterior.mu.detach()):
        bound = matrix.shape[-2] ** -0.5
        assert 0.5 * bound < matrix.abs().max() <= bound
        assert bias.abs().max() <= bound
    torch.testing.assert_close(net.posterior.sigma, torch.full_like(net.posterior.mu, 0.03))
    assert not torch.equal(net.posterior.mu[0], net.posterior.mu[1])
    trained(net).reset_parameters()
    torch.testing.assert_close(net.posterior.sigma, torch.full_like(net.posterior.mu, 0.03))
    assert net.posterior.mu.abs().max() <= 10**-0.5


@pytest.mark.parametrize(
    ("exploration", "mode"),
    [
        (ExplorationType.RANDOM, "draw"),
        (ExplorationType.DETERMINISTIC, "mean"),
        (ExplorationType.MEAN, "mean"),
        (ExplorationType.MODE, "mean"),
    ],
)
def test_the_exploration_type_decides_where_nothing_else_does(exploration, mode):
    net, x = BayesMLP(4, 3, (8,)), torch.randn(6, 4)
    with set_exploration_type(exploration):
        assert resolve_weight_mode(None) == mode
        assert bool(net(x).any()) == (mode == "draw")  # the mean network is 0
        with weight_scope("mean"):
            assert not net(x).any()
        assert net(x, "local").any()
    assert resolve_weight_mode(None) == "mean"  # outside of any context, as NoisyLinear


def test_weight_modes_nest_and_end_on_errors():
    def fail_in_mode_mean():
        with weight_scope("mean"):
            assert current_scope().mode == "mean"
            raise RuntimeError

    assert current_scope().mode is None
    noise = NoisePool()
    with weight_scope("draw", noise=noise):
        with pytest.raises(RuntimeError):
            fail_in_mode_mean()
        assert current_scope().mode == "draw"
        with weight_scope(kl="closed"):  # what is not given is as outside
            assert current_scope().mode == "draw"
            assert current_scope().noise is noise
    assert current_scope().mode is None
    assert current_scope().kl is None


def test_given_weights_reach_only_their_module():
    first, second, x = BayesLinear(3, 3), BayesLinear(3, 3), torch.randn(4, 3)
    weights = first.draw_weights()
    with weight_scope(weights={first: weights}):
        torch.testing.assert_close(first(x, "mean"), first(x, weights=weights))
        assert not second(x, "mean").any()
    assert not first(x, "mean").any()


def test_weights_of_what_has_no_posterior_are_refused():
    layer = BayesLinear(3, 3)
    message = "modules with a posterior, or of posteriors, got a key of type Sequential"
    with (
        pytest.raises(ValueError, match=message),
        weight_scope(weights={torch.nn.Sequential(layer): layer.draw_weights()}),
    ):
        pass
    with weight_scope(weights={layer.posterior: layer.posterior.mu + 1}):
        assert layer(torch.ones(4, 3)).eq(4).all()


@pytest.mark.parametrize("given", [False, True])
def test_another_mode_is_refused(given):
    net, x = BayesMLP(4, 3), torch.randn(6, 4)
    message = r"mode must be one of \['draw', 'local', 'mean'\], got 'sample'"
    with pytest.raises(ValueError, match=message):
        net(x, "sample", net.draw_weights() if given else None)
    with pytest.raises(ValueError, match=message), weight_scope("sample"):
        pass


@pytest.mark.parametrize("value", [0.0, -1.0, "fanin"])
def test_another_start_is_refused(value):
    with pytest.raises(ValueError, match=f"prior_std must be positive or 'fan_in', got {value!r}"):
        BayesMLP(4, 3, prior_std=value)
    with pytest.raises(ValueError, match=r"mean_init must be one of \['zero', 'kaiming'\]"):
        BayesMLP(4, 3, mean_init=value)


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
