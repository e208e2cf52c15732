"""Bayesian networks on other devices.

The meta device has shapes but no memory: whatever an operation mixes in from the CPU fails there,
without a GPU.
"""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch

from bbq_torchrl.bayes import BayesMLP, kl_divergence, weight_scope


@pytest.mark.parametrize("device", ["meta", "cuda"])
@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
@pytest.mark.parametrize("start", ["made there", "moved there", "by default"])
def test_values_kl_and_gradients_stay_on_the_device(device, mode, start):
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    settings = {"replicas": (2,), "prior_std": "fan_in", "mean_init": "kaiming", "std_init": 0.05}
    with torch.device(device if start == "by default" else "cpu"):
        made_on = device if start == "made there" else None
        net = BayesMLP(4, 3, (8,), device=made_on, **settings)
    net = net.to(device) if start == "moved there" else net
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
