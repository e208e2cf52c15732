"""Activation checkpointing leaves the gradients unchanged."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, bayes_loss, noisy_loss, plain_loss, transitions
from torch import nn
from torch.utils.checkpoint import checkpoint
from torchrl.data import Categorical

from bbq_torchrl.bayes import BayesConv2d, BayesLinear, BayesMLP, weight_scope
from bbq_torchrl.networks import BootstrapMLP, FlatMLP, NoisyMLP, q_actor
from bbq_torchrl.objectives import BBQNLoss
from bbq_torchrl.objectives.td_loss import td_loss

recomputed = partial(checkpoint, use_reentrant=False)


def called(function, *args):
    return function(*args)


def gradients(run, parameters, call):
    """The gradients of the output of ``run``, always with the same draw."""
    torch.manual_seed(0)
    return torch.autograd.grad(run(call), parameters, allow_unused=True)


def assert_the_same(run, parameters):
    expected = gradients(run, parameters, called)
    assert any(slope is not None and slope.any() for slope in expected)
    for found, slope in zip(gradients(run, parameters, recomputed), expected, strict=True):
        assert slope is None if found is None else torch.equal(found, slope)


@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
@pytest.mark.parametrize(
    ("make", "features"),
    [
        (partial(BayesMLP, 4, 3, (5, 6)), (4,)),
        (partial(BayesLinear, 4, 3), (4,)),
        (partial(BayesConv2d, 2, 3, 3), (2, 6, 5)),
        (partial(FlatMLP, 4, 3, (5, 6), dropout=0.3), (4,)),
        (partial(NoisyMLP, 4, 3, (5, 6)), (4,)),
        (partial(BootstrapMLP, 4, 3, (5, 6), heads=2, prior_scale=1.0), (4,)),
    ],
)
def test_a_network_learns_the_same(make, features, mode):
    net, x = make(), torch.randn(6, *features, requires_grad=True)

    def inside(x):
        with weight_scope(mode):
            return net(x)

    assert_the_same(lambda call: (call(inside, x) - 1).square().sum(), [x, *net.parameters()])


@pytest.mark.parametrize("kind", ["closed", "sampled"])
def test_a_draw_and_its_kl_have_the_same_gradients(kind):
    net, x = BayesMLP(4, 3, (5,)), torch.randn(6, 4)

    def bound(x):
        with weight_scope("draw", kl=kind) as scope:
            fit = net(x).square().sum()
        return fit + scope.kl.total()

    assert_the_same(lambda call: call(bound, x), list(net.parameters()))


def test_the_loss_of_chosen_values_has_the_same_gradient():
    values = torch.randn(8, ACTIONS, requires_grad=True)
    index, target = torch.randint(ACTIONS, (8, 1)), torch.randn(8, 1)
    assert_the_same(lambda call: call(td_loss, values, index, target)[0], [values])


@pytest.mark.parametrize("make", [bayes_loss, partial(plain_loss, dropout=0.3), noisy_loss])
def test_a_whole_loss_learns_the_same(make):
    loss, _ = make()
    td = transitions()
    assert_the_same(lambda call: call(lambda: loss(td)["loss"]), list(loss.parameters()))


class Block(nn.Module):
    """A Bayesian layer is run again for the gradient with the weights of its first run."""

    def __init__(self):
        super().__init__()
        self.layer, self.call = BayesMLP(FEATURES, ACTIONS, (8,)), called

    def forward(self, x):
        weights = self.layer.posterior.weights()
        return self.call(self.layer, x, None, weights)


@pytest.mark.parametrize("kl", ["closed", "sampled"])
def test_a_layer_inside_of_a_loss_learns_the_same_with_its_weights_handed_over(kl):
    block, td = Block(), transitions()
    actor = q_actor(block, Categorical(ACTIONS))
    loss = BBQNLoss(actor, num_data=100, delay_value=False, kl=kl)

    def value(call):
        block.call = call
        return loss(td)["loss"]

    assert_the_same(value, list(loss.parameters()))
