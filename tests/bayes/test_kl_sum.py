"""KLSum and kl_divergence: any network's KL, each layer once."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from bbq_torchrl.bayes import BayesLinear, BayesMLP, kl_divergence, weight_scope


@pytest.fixture
def network():
    net = nn.Sequential(
        BayesLinear(3, 4, replicas=(2,)), nn.Tanh(), BayesLinear(4, 2, replicas=(2,))
    )
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return net


@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
def test_a_network_is_as_far_from_the_prior_as_its_layers_together(network, mode):
    with weight_scope(mode, kl="closed") as scope:
        network(torch.randn(2, 5, 3))
    expected = network[0].posterior.kl() + network[2].posterior.kl()
    torch.testing.assert_close(scope.kl.total(), expected)
    torch.testing.assert_close(kl_divergence(network), expected)
    assert expected.shape == (2,)


@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_a_layer_that_runs_twice_counts_once(network, kind):
    x = torch.randn(2, 5, 3)
    with weight_scope("draw", kl=kind) as scope:
        first, of_first = network(x), scope.kl.total()
        second = network(x)
    assert not torch.equal(first, second)
    assert torch.equal(scope.kl.total(), of_first)


def test_only_what_runs_inside_counts(network):
    other = BayesMLP(3, 2)
    with weight_scope("draw", kl="closed") as outer:
        network(torch.randn(2, 5, 3))
        with weight_scope(kl="closed") as inner:
            other(torch.randn(5, 3))
    other(torch.randn(5, 3))
    torch.testing.assert_close(outer.kl.total(), kl_divergence(network))
    torch.testing.assert_close(inner.kl.total(), kl_divergence(other))


def test_the_sampled_kl_needs_draws(network):
    x = torch.randn(2, 5, 3)
    for mode in ("mean", "local"):
        with (
            weight_scope(mode, kl="sampled"),
            pytest.raises(ValueError, match='kl="sampled" needs weight draws'),
        ):
            network(x)
    with weight_scope("draw", kl="sampled") as scope:
        network(x)
    assert not torch.allclose(scope.kl.total(), kl_divergence(network))


def test_nothing_collected_is_an_error():
    with weight_scope(kl="closed") as scope:
        nn.Linear(3, 2)(torch.randn(5, 3))
    with pytest.raises(RuntimeError, match="no Bayesian layer ran"):
        scope.kl.total()
    with pytest.raises(ValueError, match="Linear has no Bayesian layer"):
        kl_divergence(nn.Linear(3, 2))
    message = r"kl must be one of \['closed', 'sampled'\]"
    with pytest.raises(ValueError, match=message), weight_scope(kl="open"):
        pass
