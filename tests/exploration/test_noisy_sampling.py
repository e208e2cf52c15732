"""NoisySampling: acting on the noise of NoisyNet's layers."""

from __future__ import annotations

import pytest
import torch
from q_actor import ACTIONS, FEATURES, observations
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.exploration import EvaluationPolicy, Greedy, NoisySampling
from bbq_torchrl.networks import FlatMLP, NoisyMLP, q_actor

RANDOM = ExplorationType.RANDOM
REPLICAS = [(), (3,)]


def noisy_actor(replicas=(), hidden=(16,)):
    return q_actor(NoisyMLP(FEATURES, ACTIONS, hidden, replicas=replicas), Categorical(ACTIONS))


def values(policy, td):
    return policy(td.clone())["action_value"][..., 2].detach()  # action 2 is always legal


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("shared", [False, True])
def test_who_shares_the_noise(replicas, shared):
    # all rows see the same
    rows = values(NoisySampling(noisy_actor(replicas), shared=shared), observations(*replicas, 4))
    for element in rows.reshape(-1, 4):
        if shared:
            torch.testing.assert_close(element, element[:1].expand(4))
        else:
            assert torch.unique(element).numel() == 4


def test_the_mean_network_can_be_evaluated():
    actor, td = noisy_actor((2,)), observations(2, 4)
    with set_exploration_type(RANDOM):
        expected = actor[0].module(td["observation"], "mean")[..., 2]
        torch.testing.assert_close(values(EvaluationPolicy(actor), td), expected)
        torch.testing.assert_close(values(Greedy(actor), td), expected)


def test_it_needs_noisy_layers():
    with pytest.raises(ValueError, match="NoisyNet needs a network with noisy layers"):
        NoisySampling(q_actor(FlatMLP(FEATURES, ACTIONS), Categorical(ACTIONS)))
