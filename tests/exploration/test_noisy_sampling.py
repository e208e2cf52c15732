"""NoisySampling: acting on the noise of NoisyNet's layers."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from q_actor import ACTIONS, FEATURES, all_legal, observations
from tensordict.nn import TensorDictSequential
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import EGreedyModule

from bbq_torchrl.exploration import EvaluationPolicy, Greedy, NoisySampling
from bbq_torchrl.networks import FlatMLP, NoisyMLP, q_actor

RANDOM = ExplorationType.RANDOM
EXPLORATIONS = [None, *ExplorationType]
REPLICAS = [(), (3,)]


def noisy_actor(replicas=(), hidden=(16,)):
    return q_actor(NoisyMLP(FEATURES, ACTIONS, hidden, replicas=replicas), Categorical(ACTIONS))


def values(policy, td):
    return policy(td.clone())["action_value"][..., 2].detach()  # action 2 is always legal


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("exploration", EXPLORATIONS)
def test_it_explores_under_random_and_outside_of_a_context_only(replicas, shared, exploration):
    actor = noisy_actor(replicas)
    policy, td = NoisySampling(actor, shared=shared), observations(*replicas, 4, same=False)
    mean = values(Greedy(actor), td)
    with set_exploration_type(exploration):
        first, again = values(policy, td), values(policy, td)
    if exploration in (RANDOM, None):
        assert not torch.equal(first, mean)
        assert not torch.equal(first, again)  # new at every step
    else:
        assert torch.equal(first, mean)
        assert torch.equal(again, mean)


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


def test_rows_with_noise_of_their_own_are_uncorrelated_and_spread_as_shared_noise():
    # one noisy network in n copies, each with one row; against n rows of one
    n = 4000
    one, many = noisy_actor(), noisy_actor((n,))
    with torch.no_grad():
        for ours, theirs in zip(many.parameters(), one.parameters(), strict=True):
            ours.copy_(theirs.expand_as(ours))
    td = observations(n)
    rows = values(NoisySampling(one), td)
    shared = values(NoisySampling(many, shared=True), td.unsqueeze(1)).squeeze(1)
    assert abs(torch.corrcoef(torch.stack([rows[1:], rows[:-1]]))[0, 1]) < 5 * n**-0.5
    spread = shared.std()
    assert abs(rows.mean() - shared.mean()) < 5 * spread * (2 / n) ** 0.5
    # each layer multiplies by a noise of kurtosis π/2 and adds many: below 12 for two of them
    assert (rows.std() / spread).item() == pytest.approx(1, abs=5 * (2 * 12 / (4 * n)) ** 0.5)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("exploration", EXPLORATIONS)
@pytest.mark.parametrize("with_epsilon", [False, True])
def test_no_forbidden_action_is_taken(replicas, shared, exploration, with_epsilon):
    policy = NoisySampling(noisy_actor(replicas), shared=shared)
    if with_epsilon:
        epsilon = EGreedyModule(Categorical(ACTIONS), 0.5, 0.5, action_mask_key="action_mask")
        policy = TensorDictSequential(policy, epsilon)
    with set_exploration_type(exploration):
        for _ in range(3):
            td = policy(observations(*replicas, 200, same=False))
            assert td["action"].shape == (*replicas, 200)
            assert td["action"].dtype == torch.int64
            assert all_legal(td)


def test_the_action_is_greedy_on_the_values_that_are_written():
    td = NoisySampling(noisy_actor())(observations(50, same=False))
    assert torch.equal(td["action"], td["action_value"].argmax(-1))


def test_it_has_specs_keys_copies_and_states():
    policy, td = NoisySampling(noisy_actor((3,))), observations(3, 4)
    assert {"observation", "action_mask"} <= set(policy.in_keys)
    assert "action" in policy.out_keys
    assert policy.spec["action"] == Categorical(ACTIONS)
    copy = deepcopy(policy)
    copy.load_state_dict(policy.state_dict())
    results = []
    for made in (policy, copy):
        torch.manual_seed(0)
        results.append(values(made, td))
    assert torch.equal(*results)
    with torch.no_grad():
        for parameter in copy.parameters():
            parameter.add_(1.0)
    torch.manual_seed(0)
    assert torch.equal(values(policy, td), results[0])


def test_the_mean_network_can_be_evaluated():
    actor, td = noisy_actor((2,)), observations(2, 4)
    with set_exploration_type(RANDOM):
        expected = actor[0].module(td["observation"], "mean")[..., 2]
        torch.testing.assert_close(values(EvaluationPolicy(actor), td), expected)
        torch.testing.assert_close(values(Greedy(actor), td), expected)


def test_it_needs_noisy_layers():
    with pytest.raises(ValueError, match="NoisyNet needs a network with noisy layers"):
        NoisySampling(q_actor(FlatMLP(FEATURES, ACTIONS), Categorical(ACTIONS)))
