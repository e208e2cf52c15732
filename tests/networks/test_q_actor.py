"""What a Q-network's actor chooses."""

from __future__ import annotations

import pickle

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import OneHot

from bbq_torchrl.networks import q_actor


class Zeros(nn.Module):
    def forward(self, x):
        return torch.zeros(*x.shape[:-1], 4)


def test_of_actions_of_one_value_one_legal_action_is_chosen():
    actor = pickle.loads(pickle.dumps(q_actor(Zeros(), OneHot(4))))
    mask = torch.tensor([[False, True, False, True], [True] * 4])
    td = actor(TensorDict(observation=torch.ones(2, 2), action_mask=mask, batch_size=[2]))
    assert td["action"].tolist() == [[0, 1, 0, 0], [1, 0, 0, 0]]
    assert td["chosen_action_value"].tolist() == [[0], [0]]
