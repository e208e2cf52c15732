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

# Tracing is what may break; a backend that generates code would only take longer.
BACKEND = "aot_eager"

LOSSES = {
    "dqn": lambda: plain_loss((2,), dropout=0.5),
    "double dqn": lambda: plain_loss((2,), double_dqn=True),
    "bbqn map": lambda: bayes_loss((2,), hold=True),
    "bbqn mc": lambda: bayes_loss((2,), target="mc", kl="sampled"),
    "bbqn mc shared": lambda: bayes_loss((2,), target="mc", target_noise="shared"),
    "bootstrap": lambda: heads_loss((2,)),
    "noisy": lambda: noisy_loss((2,)),
}


@pytest.mark.parametrize("kl", ["closed", "sampled"])
@pytest.mark.parametrize("replicas", [(), (3,)], ids=str)
def test_a_draw_with_its_kl_is_one_graph(replicas, kl):
    net = BayesMLP(
        80, 60, (90,), replicas=replicas, std_init=0.2
    )  # enough weights for fast normals
    x = torch.randn(*replicas, 5, 80)

    def value():
        with weight_scope("draw", kl=kl) as scope:
            out = net(x)
            return out.square().mean() + scope.kl.total().sum()

    compiled = torch.compile(value, fullgraph=True, backend=BACKEND)
    torch.manual_seed(0)
    found = compiled()
    gradients = torch.autograd.grad(found, list(net.parameters()))
    assert compiled() != found  # noise is new at every call
    # the same numbers from torch's generator, without a graph
    torch.manual_seed(0)
    noise = torch.randn(net.posterior.mu.shape)

    with weight_scope(noise=FixedNoise(noise)):
        expected = value()
    torch.testing.assert_close(found, expected)
    for own, reference in zip(
        gradients, torch.autograd.grad(expected, list(net.parameters())), strict=True
    ):
        torch.testing.assert_close(own, reference)


@pytest.mark.parametrize("name", LOSSES)
def test_a_loss_with_its_gradient_is_one_graph(name):
    loss, update = LOSSES[name]()
    update.step()
    td = transitions((2,))

    def value(td):
        return loss(td)["loss"]

    found = torch.compile(value, fullgraph=True, backend=BACKEND)(td.clone())
    found.backward()
    assert found.isfinite()
    assert all(p.grad.isfinite().all() and p.grad.any() for p in loss.parameters())
    if name == "double dqn":
        loss.zero_grad()
        expected = value(td)
        torch.testing.assert_close(found, expected)


def test_a_pool_gives_the_traced_code_new_noise_all_the_same():
    net, pool = BayesMLP(4, 3), NoisePool()

    def value(x):
        with weight_scope("draw", noise=pool):
            return net(x)

    compiled, x = torch.compile(value, fullgraph=True, backend=BACKEND), torch.ones(4)
    assert not torch.equal(compiled(x), compiled(x))
