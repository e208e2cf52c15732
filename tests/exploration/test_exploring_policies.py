"""All policies and those of evaluation: their actions, and errors."""

from copy import deepcopy

import pytest
import torch
from q_actor import ACTIONS, FEATURES, SPEC, all_legal, bayes_actor, observations, policies, values
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torch import nn
from torchrl.data import Binary, Categorical, OneHot
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.exploration import (
    BootstrapSampling,
    EvaluationPolicy,
    Greedy,
    MajorityVote,
    NoisySampling,
    ThompsonSampling,
)
from bbq_torchrl.exploration.draws import q_draws
from bbq_torchrl.networks import FlatMLP, bootstrap_actor, q_actor

RANDOM, DETERMINISTIC = ExplorationType.RANDOM, ExplorationType.DETERMINISTIC


@pytest.mark.parametrize("replicas", [(), (3,)])
@pytest.mark.parametrize(
    ("exploration", "spec"),
    [(RANDOM, SPEC), (DETERMINISTIC, SPEC), (None, SPEC), (None, OneHot(ACTIONS))],
    ids=["random", "deterministic", "none", "one-hot"],
)
def test_no_policy_takes_a_forbidden_action(replicas, exploration, spec):
    with set_exploration_type(exploration):
        for name, policy in policies(replicas, spec).items():
            for rows in (200, 200, 0):
                td = policy(observations(*replicas, rows, same=False))
                assert td["action"].shape == (*replicas, rows, *spec.shape), name
                assert td["action"].dtype == torch.int64, name
                assert all_legal(td), name


def test_policies_have_specs_keys_and_copies_with_networks_of_their_own():
    td = observations(3, 4)
    for name, policy in policies((3,)).items():
        assert {"observation", "action_mask"} <= set(policy.in_keys), name
        assert "action" in policy.out_keys, name
        if not isinstance(policy, TensorDictSequential):
            assert policy.spec["action"] == SPEC, name
            of_policy, of_actor = map(TensorDict.from_module, (policy, policy.actor))
            assert set(of_policy.keys(True, True)) == set(of_actor.keys(True, True)), name
            assert [*policy.state_dict()] == [*policy.actor.state_dict()], name
        values(policy, td)  # where draws are held, the copy holds the same
        found = []
        for made in (policy, deepcopy(policy)):
            torch.manual_seed(0)
            found.append(values(made, td))
            with torch.no_grad():
                for parameter in made.parameters():
                    parameter.add_(1.0)
        assert torch.equal(*found), name


@pytest.mark.parametrize("policy", [Greedy, EvaluationPolicy, MajorityVote, BootstrapSampling])
@pytest.mark.parametrize("exploration", [RANDOM, DETERMINISTIC, None])
def test_dropout_is_off_under_every_exploration_type(policy, exploration):
    net, td = FlatMLP(FEATURES, ACTIONS, (32,), dropout=0.5), observations(20)
    actor = q_actor(net, SPEC)
    if policy in (MajorityVote, BootstrapSampling):
        actor = bootstrap_actor(nn.Sequential(net, nn.Unflatten(-1, (1, -1))), SPEC)
    expected = net(td["observation"], "mean")[:, 2].detach()
    torch.testing.assert_close(values(policy(actor), td, exploration), expected)


BAYES, PLAIN = bayes_actor(), q_actor(FlatMLP(FEATURES, ACTIONS), SPEC)
NET = PLAIN[0].module


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("Bayesian", lambda: ThompsonSampling(PLAIN)),
        ("Bayesian", lambda: EvaluationPolicy(PLAIN, mode="draw")),
        ("noisy", lambda: NoisySampling(PLAIN)),
        ("VoteModule", lambda: MajorityVote(PLAIN)),
        ("actor", lambda: ThompsonSampling(NET)),
        ("per", lambda: ThompsonSampling(BAYES, per="game")),
        ("is_init", lambda: ThompsonSampling(BAYES, per="episode")(TensorDict(batch_size=[3]))),
        ("mode", lambda: EvaluationPolicy(BAYES, mode="median")),
        ("num_draws", lambda: EvaluationPolicy(BAYES, num_draws=0)),
        ("action_key", lambda: q_actor(NET, SPEC, action_key="act")),
        ("spec", lambda: bootstrap_actor(NET, Binary(ACTIONS))),
    ],
)
def test_what_a_policy_needs_is_named(key, wrong):
    with pytest.raises(ValueError, match=key):
        wrong()


REPLICAS = [(), (3,)]


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize(("mode", "draws"), [("mean", 0), ("average", 4), ("draw", 1)])
def test_values_are_those_of_the_mean_network_or_the_mean_over_draws(mode, draws, replicas):
    actor, td = bayes_actor(replicas), observations(*replicas, 8)
    net, legal = actor[0].module, td["action_mask"]
    with torch.no_grad():
        net.posterior.mu.normal_()
    torch.manual_seed(0)
    with set_exploration_type(ExplorationType.RANDOM):
        out = EvaluationPolicy(actor, mode=mode, num_draws=4)(td.clone())
    torch.manual_seed(0)
    weights = [net.draw_weights() for _ in range(draws)] or [net.posterior.mu]
    expected = torch.stack([net(td["observation"], weights=own) for own in weights]).mean(0)
    torch.testing.assert_close(out["action_value"][legal], expected[legal].detach())
    assert torch.equal(out["action"], expected.masked_fill(~legal, -torch.inf).argmax(-1))


def test_thompson_acts_as_the_policy_that_trains_whatever_the_exploration_type():
    actor, td = bayes_actor((3,)), observations(3, 8)
    policy = EvaluationPolicy(actor, mode="thompson")
    torch.manual_seed(0)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        drawn = policy(td.clone())
    torch.manual_seed(0)
    trained = ThompsonSampling(actor)(td.clone())
    for key in ("action", "action_value"):
        assert torch.equal(drawn[key], trained[key])
    assert not torch.equal(policy(td.clone())["action_value"], drawn["action_value"])


def test_dropout_is_a_posterior():
    """Of a network with one hidden unit, the values with and without it are all there is."""
    network = FlatMLP(2, 3, (1,), dropout=0.25)
    with torch.no_grad():
        network.weight.copy_(torch.tensor([1.0, 1.0, 0.0, 3.0, 6.0, 9.0, 0.5, 0.5, 0.5]))
    policy = Greedy(q_actor(network, Categorical(3), action_mask_key=None)).eval()
    draws = q_draws(policy, torch.tensor([[1.0, 1.0]]), 4_000)
    on = 0.5 + torch.tensor([3.0, 6.0, 9.0]) * 2 / 0.75
    is_on = (draws - on).abs().amax(-1) < 1e-4
    assert torch.equal(draws[~is_on], torch.full_like(draws[~is_on], 0.5))
    assert is_on.float().mean() == pytest.approx(0.75, abs=0.03)
    network.dropout = 0.0
    assert q_draws(policy, torch.tensor([[1.0, 1.0]]), 9) is None
