"""The scope around a call: which weights its layers use, and what their KL is."""

import pytest
import torch
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.bayes import BayesLinear, BayesMLP, kl_divergence, weight_scope
from bbq_torchrl.bayes.layers import local_weight_scope
from bbq_torchrl.bayes.noise import NoisePool
from bbq_torchrl.bayes.scope import current_scope


@pytest.fixture
def network():
    net = nn.Sequential(
        BayesLinear(3, 4, replicas=(2,)), nn.Tanh(), BayesLinear(4, 2, replicas=(2,))
    )
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return net


X = torch.ones(2, 5, 3)


@pytest.mark.parametrize("name", ["RANDOM", "DETERMINISTIC", "MEAN", "MODE"])
def test_the_exploration_type_decides_where_nothing_else_does(name):
    net, x = BayesMLP(4, 3, (8,), mean_init="zero"), torch.randn(6, 4)
    with set_exploration_type(ExplorationType[name]):
        assert bool(net(x).any()) == (name == "RANDOM")  # the mean network is 0
        with weight_scope("mean"):
            assert not net(x).any()
        assert net(x, "local").any()
    assert not net(x).any()  # outside of any context, as NoisyLinear


def test_scopes_nest_and_end_on_errors():
    def fail_inside():
        with weight_scope("mean") as inner:
            assert current_scope() is inner
            raise RuntimeError

    noise = NoisePool()
    with weight_scope("draw", noise=noise) as outer:
        with pytest.raises(RuntimeError):
            fail_inside()
        assert current_scope() is outer
        with weight_scope(kl="closed") as inner:  # what is not given is as outside
            assert (inner.mode, inner.noise) == ("draw", noise)
    assert current_scope().mode is None
    assert current_scope().kl is None


def test_given_weights_reach_only_their_module_or_posterior():
    first, second = (BayesLinear(3, 3, mean_init="zero") for _ in range(2))
    x = torch.ones(4, 3)
    for key in (first, first.posterior):
        with weight_scope(weights={key: first.posterior.mu + 1}):
            assert first(x, "mean").eq(4).all()
            assert first(x, "local").eq(4).all()
            assert not second(x, "mean").any()
    assert not first(x, "mean").any()


def test_given_weights_are_used_in_a_scope_of_separate_draws_too():
    net, x = BayesMLP(3, 2), torch.ones(4, 3)
    with weight_scope(weights={net: net.draw_weights((4,))}):
        given = net(x)
        with local_weight_scope(net, x.shape[:1]):
            assert torch.equal(net(x), given)


@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
def test_the_kl_is_that_of_all_layers_that_run_inside_each_counted_once(network, mode):
    other = BayesMLP(3, 2, (8,))
    with weight_scope(mode, kl="closed") as outer:
        first, second = network(X), network(X)
        with weight_scope(kl="closed") as inner:
            other(X)
    other(X)
    assert torch.equal(first, second) == (mode == "mean")
    expected = network[0].posterior.kl() + network[2].posterior.kl()
    assert expected.shape == (2,)
    torch.testing.assert_close(outer.kl.total(), expected)
    torch.testing.assert_close(kl_divergence(network), expected)
    torch.testing.assert_close(inner.kl.total(), kl_divergence(other))


def test_the_sampled_kl_is_that_of_the_first_draw(network):
    with weight_scope("draw", kl="sampled") as scope:
        network(X)
        of_first = scope.kl.total()
        network(X)
    assert torch.equal(scope.kl.total(), of_first)
    assert not torch.allclose(of_first, kl_divergence(network))


@pytest.mark.parametrize(
    ("key", "settings"),
    [
        ("mode", {"mode": "sample"}),
        ("kl", {"kl": "open"}),
        ("kl", {"mode": "mean", "kl": "sampled"}),
        ("kl", {"mode": "local", "kl": "sampled"}),
        ("weights", {"weights": {nn.Tanh(): torch.ones(3)}}),
    ],
)
def test_what_is_no_scope_is_refused(network, key, settings):
    with pytest.raises(ValueError, match=key), weight_scope(**settings):
        network(X)


def test_another_mode_is_refused_whatever_weights_are_given():
    net = BayesLinear(3, 4)
    with pytest.raises(ValueError, match="mode"):
        net(torch.ones(5, 3), "sample", net.draw_weights())


def test_the_kl_of_no_bayesian_layer_is_an_error():
    with weight_scope(kl="closed") as scope:
        nn.Linear(3, 2)(X)
    with pytest.raises(RuntimeError, match="Bayesian"):
        scope.kl.total()
    with pytest.raises(ValueError, match="Bayesian"):
        kl_divergence(nn.Linear(3, 2))
