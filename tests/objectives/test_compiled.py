"""Draws and losses as one graph of torch.compile."""

from __future__ import annotations

import pytest
import torch
from q_transitions import FixedNoise, bayes_loss, heads_loss, noisy_loss, plain_loss, transitions

from bbq_torchrl.bayes import BayesMLP, weight_scope
from bbq_torchrl.bayes.noise import NoisePool

pytestmark = [
    pytest.mark.slow,
    # torch.compile's own, of a custom autograd function
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
]


def compiled(function):
    # Tracing is what may break; a backend that generates code would only take longer.
    return torch.compile(function, fullgraph=True, backend="aot_eager")


@pytest.mark.parametrize("kl", ["closed", "sampled"])
@pytest.mark.parametrize("replicas", [(), (3,)], ids=str)
def test_a_draw_with_its_kl_is_one_graph(replicas, kl):
    sizes = (80, 60, (90,))  # enough weights for fast normals
    net, x = BayesMLP(*sizes, replicas=replicas, std_init=0.2), torch.randn(*replicas, 5, 80)

    def value():
        with weight_scope("draw", kl=kl) as scope:
            return net(x).square().mean() + scope.kl.total().sum()

    draw = compiled(value)
    torch.manual_seed(0)
    found = draw()
    assert draw() != found  # noise is new at every call
    # the same numbers from torch's generator, without a graph
    torch.manual_seed(0)
    with weight_scope(noise=FixedNoise(torch.randn(net.posterior.mu.shape))):
        expected = value()
    torch.testing.assert_close(found, expected)
    parameters = list(net.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(found, parameters), torch.autograd.grad(expected, parameters)
    )


def test_a_pool_gives_the_traced_code_new_noise_all_the_same():
    net, pool = BayesMLP(4, 3), NoisePool()

    def value(x):
        with weight_scope("draw", noise=pool):
            return net(x)

    draw, x = compiled(value), torch.ones(4)
    assert not torch.equal(draw(x), draw(x))


@pytest.mark.parametrize(
    ("make", "settings"),
    [
        (plain_loss, {"dropout": 0.5}),
        (plain_loss, {"double_dqn": True}),
        (bayes_loss, {"cache": True}),
        (bayes_loss, {"target": "mc", "kl": "sampled"}),
        (bayes_loss, {"target": "mc", "target_noise": "shared"}),
        (heads_loss, {}),
        (noisy_loss, {}),
    ],
)
def test_a_loss_with_its_gradient_is_one_graph(make, settings):
    (loss, update), td = make((2,), **settings), transitions((2,))
    update.step()
    found = compiled(lambda td: loss(td)["loss"])(td.clone())
    found.backward()
    assert found.isfinite()
    assert all(p.grad.isfinite().all() and p.grad.any() for p in loss.parameters())
    if "double_dqn" in settings:  # has no noise
        torch.testing.assert_close(found, loss(td)["loss"])
