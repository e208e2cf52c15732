"""Dynamics models, and losses with them, for the tests of the losses."""

import pickle
from copy import deepcopy

import torch
from q_transitions import ACTIONS, FEATURES, off_prior

from bbq_torchrl.vime import DynamicsLoss, DynamicsModel

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


def result(loss, td):
    torch.manual_seed(0)
    return loss(td)


def gradients(loss, td):
    return torch.autograd.grad(result(loss, td)["loss"], list(loss.parameters()))
