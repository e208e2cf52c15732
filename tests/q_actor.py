"""Actors and observations for the tests of policies."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.networks import q_actor

FEATURES, ACTIONS = 5, 6


def bayes_actor(replicas=(), hidden=(16,)):
    """An actor at the prior with a spread that makes its actions vary."""
    net = BayesMLP(FEATURES, ACTIONS, hidden, replicas=replicas, prior_std=1.0)
    return q_actor(net, Categorical(ACTIONS))


def observations(*batch, same=True):
    """States with a random mask in which at least one action is legal; the same for all rows."""
    shape = (1,) * len(batch) if same else batch
    mask = torch.rand(*shape, ACTIONS) < 0.5
    mask[..., 2] = True
    return TensorDict(
        {
            "observation": torch.randn(*shape, FEATURES).expand(*batch, FEATURES).clone(),
            "action_mask": mask.expand(*batch, ACTIONS).clone(),
            "is_init": torch.zeros(*batch, 1, dtype=torch.bool),
        },
        batch,
    )


def values(policy, td, exploration=ExplorationType.RANDOM):
    """The value of an action that is always legal, for each row."""
    with set_exploration_type(exploration):
        return policy(td.clone())["action_value"][..., 2].detach()


def all_legal(td):
    return bool(td["action_mask"].gather(-1, td["action"].unsqueeze(-1)).all())
