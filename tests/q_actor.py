"""Actors and observations for the tests of policies."""

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.networks import BootstrapMLP, NoisyMLP, bootstrap_actor, q_actor

FEATURES, ACTIONS = 5, 6


SPEC = Categorical(ACTIONS)


def bayes_actor(replicas=(), spec=SPEC):
    """An actor at the prior with a spread that makes its actions vary."""
    start = {"prior_std": 1.0, "mean_init": "zero", "std_init": None}
    net = BayesMLP(FEATURES, ACTIONS, (16,), replicas=replicas, **start)
    return q_actor(net, spec)


def noisy_actor(replicas=(), spec=SPEC):
    return q_actor(NoisyMLP(FEATURES, ACTIONS, (16,), replicas=replicas), spec)


def heads_actor(replicas=(), spec=SPEC, heads=7):
    net = BootstrapMLP(FEATURES, ACTIONS, (8,), heads=heads, replicas=replicas)
    return bootstrap_actor(net, spec)


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
    """Whether every action, an index or one-hot, is one that the mask allows."""
    action, mask = td["action"], td["action_mask"]
    taken = action if action.shape == mask.shape else F.one_hot(action, mask.shape[-1])
    return bool((taken.sum(-1) == 1).all() and (taken.bool() & mask).any(-1).all())
