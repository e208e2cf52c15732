"""Bayesian networks: modes, draws, moments, the prior's spread of Q."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from torch import nn
from torch.func import functional_call
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.bayes import BayesLinear, BayesMLP, weight_scope
from bbq_torchrl.bayes.scope import current_scope, resolve_weight_mode

REPLICAS = [(), (3,), (2, 3)]


def trained(net):
    """Gives the posterior means and spreads away from the prior."""
    with torch.no_grad():
        net.posterior.mu.normal_(0, 0.3)
        net.posterior.rho.uniform_(-3, 0)
    return net


def by_hand(net, x, flat):
    """One network after the other, from its definition."""
    replicas = net.replicas
    outs = []
    for a, b in zip(
        x.reshape(-1, *x.shape[len(replicas) :]), flat.reshape(-1, flat.shape[-1]), strict=True
    ):
        out = a
        for k, (matrix, bias) in enumerate(net.layout.unflatten(b)):
            out = (out if k == 0 else out.relu()) @ matrix + bias
        outs.append(out)
    return torch.stack(outs).reshape(*replicas, *outs[0].shape)


@pytest.mark.parametrize("replicas", REPLICAS)
def test_mean_mode_is_the_network_of_the_means(replicas):
    net, x = trained(BayesMLP(4, 3, (8, 8), replicas=replicas)), torch.randn(*replicas, 6, 4)
    torch.testing.assert_close(net(x, "mean"), by_hand(net, x, net.posterior.mu))


@pytest.mark.parametrize("replicas", REPLICAS)
def test_draw_mode_is_the_network_of_one_draw(replicas):
    net, x = trained(BayesMLP(4, 3, (8, 8), replicas=replicas)), torch.randn(*replicas, 6, 4)
    torch.manual_seed(0)
    weights = net.draw_weights()
    torch.manual_seed(0)
    torch.testing.assert_close(net(x, "draw"), by_hand(net, x, weights))


def test_one_network_is_the_same_with_and_without_a_replica_dimension_of_one():
    single, stacked = trained(BayesMLP(4, 3, (8,))), BayesMLP(4, 3, (8,), replicas=(1,))
    with torch.no_grad():
        stacked.posterior.mu.copy_(single.posterior.mu)
        stacked.posterior.rho.copy_(single.posterior.rho)
    x = torch.randn(6, 4)
    for mode in ("mean", "draw", "local"):
        torch.manual_seed(0)
        ours = stacked(x.unsqueeze(0), mode)[0]
        torch.manual_seed(0)
        torch.testing.assert_close(ours, single(x, mode))


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


def test_rows_share_a_draw_in_mode_draw_and_do_not_in_mode_local():
    net, x = trained(BayesMLP(4, 3, (8,))), torch.randn(4).expand(6, 4)
    draw, local = net(x, "draw"), net(x, "local")
    torch.testing.assert_close(draw, draw[:1].expand_as(draw))
    assert torch.unique(local, dim=0).shape[0] == 6


def test_replicas_draw_independently():
    net, x = BayesMLP(4, 3, (8,), replicas=(5,)), torch.randn(4).expand(5, 2, 4)
    assert torch.unique(net(x, "draw")[:, 0], dim=0).shape[0] == 5


def test_local_reparameterization_has_the_moments_of_weight_draws():
    net, x, n = trained(BayesMLP(5, 2, (16,))), torch.randn(5), 40_000
    local = net(x.expand(n, 5), "local").detach()
    drawn = net(x.expand(n, 5), weights=net.draw_weights((n,))).detach()
    spread = drawn.std(0)
    assert ((local.mean(0) - drawn.mean(0)).abs() / spread).max() < 5 * (2 / n) ** 0.5
    # A standard deviation's relative error is at most (κ / 4n)^.5 each; kurtosis κ < 8 here.
    assert (local.std(0) / spread - 1).abs().max() < 5 * (2 * 8 / (4 * n)) ** 0.5
    # two outputs of one row share the noise of the hidden units, as they do under a draw
    correlations = [torch.corrcoef(out.T)[0, 1] for out in (local, drawn)]
    assert abs(correlations[0] - correlations[1]) < 5 * (2 / n) ** 0.5


@pytest.mark.parametrize(("prior_std", "expected"), [(0.1, 0.7), (0.3, 18.0)])
def test_spread_of_q_under_the_prior_follows_the_closed_form(prior_std, expected):
    # v₁ = p² (‖x‖² + 1), v_{l+1} = p² (n_l v_l / 2 + 1), with 27 active features
    variance = prior_std**2 * (27 + 1)
    for width in (256, 256):
        variance = prior_std**2 * (width * variance / 2 + 1)
    assert variance**0.5 == pytest.approx(expected, rel=0.05)
    net, x = BayesMLP(268, 39, prior_std=prior_std), torch.zeros(268)
    x[torch.randperm(268)[:27]] = 1.0
    # Each draw of the network gives 39 outputs, independent given its hidden layer. The spread
    # of one network's outputs varies by about 10 %, so 200 networks by .7 %, and the normal
    # error of 200 · 39 numbers is .8 %.
    out = net(x.expand(200, 268), weights=net.draw_weights((200,)))
    assert out.shape == (200, 39)
    assert out.square().mean().sqrt().item() == pytest.approx(variance**0.5, rel=0.05)
    local = net(x.expand(200, 268), "local")
    assert local.square().mean().sqrt().item() == pytest.approx(variance**0.5, rel=0.05)


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


def test_reset_parameters_starts_again():
    net = BayesMLP(4, 3, (8,), std_init=0.05)
    start = deepcopy(net.state_dict())
    trained(net).reset_parameters()
    for name, value in net.state_dict().items():
        assert torch.equal(value, start[name])


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
    with weight_scope("draw"):
        with pytest.raises(RuntimeError):
            fail_in_mode_mean()
        assert current_scope().mode == "draw"
        with weight_scope(kl="closed"):  # what is not given is as outside
            assert current_scope().mode == "draw"
    assert current_scope().mode is None
    assert current_scope().kl is None


def test_given_weights_reach_only_their_module():
    first, second, x = BayesLinear(3, 3), BayesLinear(3, 3), torch.randn(4, 3)
    weights = first.draw_weights()
    with weight_scope(weights={first: weights}):
        torch.testing.assert_close(first(x, "mean"), first(x, weights=weights))
        assert not second(x, "mean").any()
    assert not first(x, "mean").any()


@pytest.mark.parametrize("mode", ["sample", "", "DRAW"])
def test_another_mode_is_refused(mode):
    net, x = BayesMLP(4, 3), torch.randn(6, 4)
    for call in (lambda: net(x, mode), lambda: weight_scope(mode)):
        with pytest.raises(ValueError, match=r"mode must be one of \['draw', 'local', 'mean'\]"):
            call()


@pytest.mark.parametrize("value", [0.0, -1.0, "fanin"])
def test_another_prior_is_refused(value):
    with pytest.raises(ValueError, match=f"prior_std must be positive or 'fan_in', got {value!r}"):
        BayesMLP(4, 3, prior_std=value)


def test_another_mean_init_is_refused():
    with pytest.raises(ValueError, match=r"mean_init must be one of \['zero', 'kaiming'\]"):
        BayesMLP(4, 3, mean_init="xavier")


def test_copies_states_and_functional_calls_agree():
    net, x = trained(BayesMLP(4, 3, (8,), replicas=(2,))), torch.randn(2, 6, 4)
    expected = net(x, "mean")
    assert torch.equal(deepcopy(net)(x, "mean"), expected)
    other = BayesMLP(4, 3, (8,), replicas=(2,))
    other.load_state_dict(net.state_dict())
    assert torch.equal(other(x, "mean"), expected)
    parameters = dict(net.named_parameters())
    called = functional_call(BayesMLP(4, 3, (8,), replicas=(2,)), parameters, (x, "mean"))
    assert torch.equal(called, expected)
    double = net.double()(x.double(), "mean")
    torch.testing.assert_close(double.float(), expected)


def test_layers_are_torch_modules_like_others():
    net = nn.Sequential(BayesLinear(4, 8), nn.Tanh(), BayesLinear(8, 2))
    with set_exploration_type(ExplorationType.RANDOM):
        assert not torch.equal(net(torch.ones(3, 4)), net(torch.ones(3, 4)))
    assert {name for name, _ in net.named_parameters()} == {
        "0.posterior.mu",
        "0.posterior.rho",
        "2.posterior.mu",
        "2.posterior.rho",
    }
