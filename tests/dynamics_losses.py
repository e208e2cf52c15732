"""Dynamics models, and losses with them, for the tests of the losses."""

from __future__ import annotations

import pickle
from copy import deepcopy

import torch
from q_transitions import ACTIONS, FEATURES, off_prior, plain_loss

from bbq_torchrl.vime import DynamicsLoss, DynamicsModel, VIMELoss

# How a loss is copied, with another one at hand that was made alike.
COPIES = {
    "state": lambda loss, other: other.load_state_dict(loss.state_dict()) and other,
    "assigned": lambda loss, other: other.load_state_dict(loss.state_dict(), assign=True) and other,
    "deepcopy": lambda loss, _: deepcopy(loss),
    "pickle": lambda loss, _: pickle.loads(pickle.dumps(loss)),
}


def model(replicas=(), dtype=torch.float, **settings):
    """A model away from the prior, with statistics of its own."""
    dynamics = DynamicsModel(FEATURES, ACTIONS, (8,), replicas=replicas, dtype=dtype, **settings)
    off_prior(dynamics.network)
    dynamics.update_statistics(1 + 2 * torch.randn(*replicas, 40, FEATURES, dtype=dtype))
    return dynamics


def dynamics_loss(replicas=(), dtype=torch.float, **settings):
    return DynamicsLoss(model(replicas, dtype), **{"num_data": 100, **settings})


def vime_loss(replicas=(), *, dtype=torch.float, kl_temperature=1.0, dynamics_every=1, **settings):
    """A DQN loss, whose settings these are, beside one of the dynamics."""
    q_loss, update = plain_loss(replicas, dtype=dtype, **settings)
    dynamics = dynamics_loss(replicas, dtype, kl_temperature=kl_temperature)
    return VIMELoss(q_loss, dynamics, dynamics_every=dynamics_every), update


def result(loss, td):
    torch.manual_seed(0)
    return loss(td)


def gradients(loss, td):
    return torch.autograd.grad(result(loss, td)["loss"], list(loss.parameters()))
