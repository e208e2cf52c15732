"""SharedNoise: the draws of several passes with one noise."""

from __future__ import annotations

import pytest
import torch
from torch import nn
from torch.func import functional_call

from bbq_torchrl.bayes import BayesLinear, BayesMLP, weight_scope
from bbq_torchrl.bayes.noise_sources import SharedNoise

REPLICAS = [(), (3,), (2, 3)]


def trained(net):
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.copy_(torch.empty_like(parameter).uniform_(-2, 1))
    return net


def several_layers(replicas=()):
    return trained(
        nn.Sequential(
            BayesLinear(4, 8, replicas=replicas), nn.Tanh(), BayesLinear(8, 2, replicas=replicas)
        )
    )


class Draw(nn.Module):
    """Draws when called, so that its posterior's parameters can be swapped."""

    def __init__(self, posterior):
        super().__init__()
        self.posterior = posterior

    def forward(self):
        return self.posterior.sample()


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("first_with_kl", [False, True])
@pytest.mark.parametrize("second_with_kl", [False, True])
def test_blocks_draw_the_same_weights(replicas, first_with_kl, second_with_kl):
    net, x = several_layers(replicas), torch.randn(*replicas, 5, 4)
    noise, outs = SharedNoise(), []
    for with_kl in (first_with_kl, second_with_kl):
        kl = "sampled" if with_kl else None
        with weight_scope("draw", noise=noise.again(), kl=kl):
            outs.append(net(x))
    assert torch.equal(*outs)
    with weight_scope("draw"):
        assert not torch.equal(net(x), outs[0])


@pytest.mark.parametrize("kl", ["closed", "sampled"])
def test_other_parameters_get_the_same_noise(kl):
    # large enough for replicas that are drawn a part at a time
    net = trained(BayesMLP(150, 40, (150, 150), replicas=(5,), dtype=torch.double))
    other = {k: v.detach() - 0.5 for k, v in net.named_parameters()}
    posterior, noise = net.posterior, SharedNoise()
    with weight_scope("draw", noise=noise, kl=kl):
        first = posterior.weights()
    with weight_scope(noise=noise.again()):
        second = functional_call(Draw(posterior), other)
    epsilon = ((first - posterior.mu) / posterior.sigma).detach()
    assert epsilon.std() == pytest.approx(1, abs=5 * (2 * epsilon.numel()) ** -0.5)
    sigma = torch.nn.functional.softplus(other["posterior.rho"])
    torch.testing.assert_close(second, other["posterior.mu"] + sigma * epsilon)


def test_a_layer_that_draws_twice_shares_draw_by_draw():
    layer, x = trained(BayesLinear(4, 4)), torch.randn(5, 4)
    noise = SharedNoise()
    with weight_scope(noise=noise.again()):
        first = [layer(x, "draw") for _ in range(2)]
    with weight_scope(noise=noise.again()):
        second = [layer(x, "draw") for _ in range(3)]
    assert not torch.equal(*first)
    for ours, theirs in zip(first, second, strict=False):
        assert torch.equal(ours, theirs)
    with weight_scope(noise=noise.again()):  # the draw that was one more is shared from now on
        third = [layer(x, "draw") for _ in range(3)]
    assert torch.equal(second[2], third[2])


def test_draws_of_other_shapes_are_refused():
    layer, noise = BayesLinear(4, 2), SharedNoise()
    with weight_scope(noise=noise.again()):
        layer.draw_weights((3,))
    with (
        weight_scope(noise=noise.again()),
        pytest.raises(ValueError, match=r"draw of shape \[10\] cannot share noise of shape \[3, 1"),
    ):
        layer.draw_weights()
