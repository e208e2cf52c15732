"""Dynamics models and losses for the tests of VIME's losses."""

from __future__ import annotations

import torch
from q_transitions import ACTIONS, FEATURES

from bbq_torchrl.vime import DynamicsLoss, DynamicsModel


def model(replicas=(), dtype=torch.float, **settings):
    """A model away from the prior, with statistics of its own."""
    dynamics = DynamicsModel(FEATURES, ACTIONS, (8,), replicas=replicas, dtype=dtype, **settings)
    with torch.no_grad():
        dynamics.network.posterior.mu.normal_(0, 0.3)
        dynamics.network.posterior.rho.uniform_(-3, -1)
    dynamics.update_statistics(1 + 2 * torch.randn(*replicas, 40, FEATURES, dtype=dtype))
    return dynamics


def dynamics_loss(replicas=(), dtype=torch.float, **settings):
    return DynamicsLoss(model(replicas, dtype), **{"num_data": 100, **settings})


def result(loss, td):
    torch.manual_seed(0)
    return loss(td)


def gradients(loss, td):
    return torch.autograd.grad(result(loss, td)["loss"], list(loss.parameters()))
