"""Errors of losses, when they are created and when they are called."""

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, bayes_loss, heads_loss, plain_loss, transitions
from torch import nn
from torch.nn.functional import one_hot
from torchrl.data import Categorical

from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss, NoisyDQNLoss

SPEC = Categorical(ACTIONS)
PLAIN = q_actor(FlatMLP(FEATURES, ACTIONS), SPEC)
DIFFERING = nn.Sequential(*(FlatMLP(4, 4, replicas=n) for n in (2, 3)))


@pytest.mark.parametrize(
    ("named", "wrong"),
    [
        ("target", lambda: bayes_loss(target="mean")),
        ("target_noise", lambda: bayes_loss(target_noise="shared")),
        ("target_noise", lambda: bayes_loss(target_noise="mean", target="mc")),
        ("kl", lambda: bayes_loss(kl="none")),
        ("noise_std", lambda: bayes_loss((3,), noise_std=0.0)),
        ("gamma", lambda: bayes_loss((3,), gamma=torch.ones(2))),
        ("gamma", lambda: plain_loss((3,), gamma=1.5)),
        ("loss_function", lambda: heads_loss(loss_function="huber")),
        ("action_space", lambda: plain_loss(action_space="binary")),
        ("margin", lambda: plain_loss()[0].imitate(0, 1)),
        ("margin", lambda: plain_loss()[0].imitate(float("nan"), 1)),
        ("factor", lambda: plain_loss()[0].imitate(1, 0)),
        ("Bayesian", lambda: BBQNLoss(PLAIN)),
        ("noisy", lambda: NoisyDQNLoss(PLAIN)),
        ("replica", lambda: DropoutDQNLoss(q_actor(DIFFERING, SPEC))),
        ("num_data", lambda: bayes_loss(num_data=None)[0](transitions())),
    ],
)
def test_what_makes_no_loss_is_named(named, wrong):
    with pytest.raises((ValueError, RuntimeError), match=named):
        wrong()


def without_last(*key):
    return lambda td: td.set(key, td[key].squeeze(-1))


BATCHES = {
    "action_mask": lambda td: td["next"].pop("action_mask"),
    "action": lambda td: td.pop("action"),
    "observation": lambda td: td.pop("observation"),
    "terminated": lambda td: td["next"].pop("terminated"),
    "reward": without_last("next", "reward"),
    "reward' and 'terminated": without_last("next", "terminated"),
    "'action'": lambda td: td.set("action", one_hot(td["action"], ACTIONS)),
    "valid": lambda td: td.set("valid", torch.ones(2, 32, 3).bool()),
}


@pytest.mark.parametrize(("key", "spoil"), BATCHES.items(), ids=BATCHES)
def test_a_batch_that_lacks_an_entry_or_has_one_of_another_shape(make, key, spoil):
    loss, td = make((2,)), transitions((2,))
    td["valid"] = torch.ones(2, 32).bool()
    spoil(td)
    with pytest.raises((KeyError, ValueError), match=key):
        loss(td)
