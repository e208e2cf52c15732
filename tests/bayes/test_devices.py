"""Bayesian networks on other devices and in other dtypes.

The meta device has shapes but no memory: whatever an operation mixes in from the CPU fails there,
without a GPU.
"""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from torch.func import functional_call

from bbq_torchrl.bayes import BayesLinear, BayesMLP, kl_divergence, weight_scope

DEVICES = [
    "meta",
    pytest.param(
        "cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
    ),
]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
@pytest.mark.parametrize("start", ["made there", "moved there"])
def test_values_kl_and_gradients_stay_on_the_device(device, mode, start):
    options = {"replicas": (2,), "prior_std": "fan_in", "mean_init": "kaiming", "std_init": 0.05}
    if start == "made there":
        net = BayesMLP(4, 3, (8,), device=device, **options)
    else:
        net = BayesMLP(4, 3, (8,), **options).to(device)
    x = torch.ones(2, 6, 4, device=device)

    with weight_scope(kl="closed") as scope:
        out = net(x, mode)
    (out.sum() + scope.kl.total().sum()).backward()

    assert out.shape == (2, 6, 3)
    assert kl_divergence(net).shape == (2,)
    tensors = [out, kl_divergence(net), net.posterior.prior_rho, net.draw_weights((6,))]
    for tensor in [*tensors, net.posterior.mu.grad, net.posterior.rho.grad]:
        assert tensor.device.type == device
    assert deepcopy(net)(x, mode).device.type == device


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
def test_the_dtype_of_the_parameters_is_that_of_the_values(dtype, mode):
    net = BayesMLP(4, 3, (8,), dtype=dtype)
    out = net(torch.ones(6, 4, dtype=dtype), mode)
    assert {out.dtype, kl_divergence(net).dtype, net.draw_weights().dtype} == {dtype}


@pytest.mark.parametrize("kind", [BayesLinear, BayesMLP])
def test_copies_states_and_functional_calls_draw_the_same_weights(kind):
    net, other = (kind(4, 3, replicas=(2,), prior_std=0.5) for _ in range(2))
    with torch.no_grad():
        net.posterior.mu.normal_()
        net.posterior.rho.uniform_(-3, 0)
    x = torch.randn(2, 6, 4)
    state = {name: value.clone() for name, value in net.state_dict().items()}

    def drawn(call):
        torch.manual_seed(0)
        return call()

    expected = drawn(lambda: net(x, "draw"))
    copy = deepcopy(net)
    assert torch.equal(drawn(lambda: functional_call(other, state, (x, "draw"))), expected)
    assert not torch.equal(drawn(lambda: other(x, "draw")), expected)
    other.load_state_dict(state)
    with torch.no_grad():
        net.posterior.mu.zero_()  # neither copy nor state follow
    for same in (copy, other):
        assert torch.equal(drawn(lambda same=same: same(x, "draw")), expected)
        assert torch.equal(kl_divergence(same), kl_divergence(copy))
