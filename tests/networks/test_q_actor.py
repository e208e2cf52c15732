"""What a Q-network's actor chooses."""

from __future__ import annotations

import pickle

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Categorical, OneHot

from bbq_torchrl.networks import bootstrap_actor, q_actor
from bbq_torchrl.networks.q_actor import masked


def constant(number):
    """A network whose values are all 0."""
    net = nn.Linear(2, number)
    nn.init.zeros_(net.weight)
    nn.init.zeros_(net.bias)
    return net


def test_of_actions_of_one_value_one_legal_action_is_chosen():
    actor = pickle.loads(pickle.dumps(q_actor(constant(4), OneHot(4))))
    mask = torch.tensor([[False, True, False, True], [True] * 4])
    td = actor(TensorDict(observation=torch.ones(2, 2), action_mask=mask, batch_size=[2]))
    assert td["action"].argmax(-1).tolist() == [1, 0]
    assert td["action"].sum(-1).tolist() == [1, 1]
    assert td["chosen_action_value"].tolist() == [[0], [0]]


@pytest.mark.parametrize("make", [q_actor, bootstrap_actor])
def test_a_spec_of_many_actions_is_refused(make):
    with pytest.raises(ValueError, match=r"env\.action_spec_unbatched, got shape \[3\]"):
        make(constant(4), Categorical(4, shape=(3,)))


def test_a_mask_of_other_actions_is_refused():
    with pytest.raises(ValueError, match="must have 4 entries, one for each action, got 1"):
        masked(torch.zeros(2, 4), torch.ones(2, 1, dtype=torch.bool))
