"""BBQN's loss stays finite wherever ρ goes, and its parts move between devices."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.bayes import BayesMLP


@pytest.mark.parametrize("rho", [-20.0, 0.0, 20.0])
@pytest.mark.parametrize("mode", ["draw", "local", "mean"])
@pytest.mark.parametrize("inputs", ["zeros", "ones"])
def test_a_networks_gradient_is_finite_for_any_rho(rho, mode, inputs):
    # at zeros the spread of the first layer is the bias' alone, whose square root local
    # reparameterization takes
    net = BayesMLP(5, 3, (64, 64))
    with torch.no_grad():
        net.posterior.rho.fill_(rho)
    x = getattr(torch, inputs)(8, 5).requires_grad_()

    out = net(x, mode)
    out.square().mean().backward()

    assert out.isfinite().all()
    assert x.grad.isfinite().all()
    assert net.posterior.mu.grad.isfinite().all()
    # the mean network does not depend on ρ
    assert mode == "mean" or net.posterior.rho.grad.isfinite().all()
