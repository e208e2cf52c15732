"""Networks under torch.autocast, against the same in float32."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.bayes import BayesGRU, BayesMLP
from bbq_torchrl.networks import BootstrapMLP, FlatMLP

NETWORKS = {
    "flat": lambda: FlatMLP(5, 4, (64, 64), replicas=2),
    "bayes": lambda: BayesMLP(5, 4, (64, 64), replicas=2),
    "gru": lambda: BayesGRU(5, 4, replicas=2),
    "bootstrap": lambda: BootstrapMLP(5, 4, (64, 64), heads=3, replicas=2, trunk_layers=1),
}


@pytest.mark.parametrize("name", list(NETWORKS))
def test_values_and_gradients_in_bfloat16_are_near_those_in_float32(name):
    net, x = NETWORKS[name](), torch.randn(2, 32, 7, 5)
    settings = {"mode": "draw"} if name in ("bayes", "gru") else {}
    found = []
    for enabled in (False, True):
        torch.manual_seed(0)  # one draw for both
        with torch.autocast("cpu", torch.bfloat16, enabled=enabled):
            out = net(x, **settings)
            out = out[0] if name == "gru" else out
        assert out.dtype == (torch.bfloat16 if enabled else torch.float32)
        found.append([out, *torch.autograd.grad(out.float().square().sum(), net.parameters())])
    for exact, rounded in zip(*found, strict=True):
        # bfloat16 has 8 bits: an error of 0.4 % for each rounding
        assert (rounded - exact).norm() < 0.1 * exact.norm()
