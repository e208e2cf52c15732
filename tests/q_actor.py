"""Actors and observations for the tests of policies."""

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import EGreedyModule

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.exploration import (
    Boltzmann,
    BootstrapSampling,
    EvaluationPolicy,
    Greedy,
    MajorityVote,
    NoisySampling,
    ThompsonSampling,
)
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


def policies_of(actor, noisy, heads, spec):
    """Every policy by name, on a Bayesian actor, a noisy one, and one with heads."""
    epsilon = EGreedyModule(spec, 0.5, 0.5, action_mask_key="action_mask")
    made = {
        "greedy": Greedy(actor),
        "epsilon": TensorDictSequential(Greedy(actor), epsilon),
        "thompson epsilon": TensorDictSequential(ThompsonSampling(actor), epsilon),
        "boltzmann": TensorDictSequential(Greedy(actor), Boltzmann(5.0, 1.0, 10)),
        "noisy epsilon": TensorDictSequential(NoisySampling(noisy), epsilon),
        "vote": MajorityVote(heads),
        "vote epsilon": TensorDictSequential(MajorityVote(heads), epsilon),
    }
    for mode in ("mean", "average", "draw", "thompson"):
        made[f"evaluation {mode}"] = EvaluationPolicy(actor, mode=mode)
    for per in ("step", "episode", "round"):
        made[f"heads {per}"] = BootstrapSampling(heads, per=per)
        for shared in (False, True):
            made[f"thompson {per} {shared}"] = ThompsonSampling(actor, per=per, shared=shared)
    for shared in (False, True):
        made[f"noisy {shared}"] = NoisySampling(noisy, shared=shared)
    return made


def policies(replicas, spec=SPEC):
    """Every policy by name, with replicas."""
    makers = (bayes_actor, noisy_actor, heads_actor)
    return policies_of(*(make(replicas, spec) for make in makers), spec)


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
