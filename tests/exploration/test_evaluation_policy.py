"""The policies of one posterior: mean network, average of draws, one draw, new draws."""

from __future__ import annotations

import pytest
import torch
from q_actor import ACTIONS, all_legal, bayes_actor, observations
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.exploration import EvaluationPolicy, ThompsonSampling
from bbq_torchrl.networks import FlatMLP, q_actor


def values(policy, td):
    return policy(td.clone())["action_value"]


@pytest.mark.parametrize("replicas", [(), (3,)])
def test_mean_is_the_mean_network(replicas):
    actor, td = bayes_actor(replicas), observations(*replicas, 8)
    net = actor[0].module
    with torch.no_grad():
        net.posterior.mu.normal_()
    with set_exploration_type(ExplorationType.RANDOM):
        out = EvaluationPolicy(actor)(td.clone())
    legal = td["action_mask"]
    torch.testing.assert_close(
        out["action_value"][legal], net(td["observation"], "mean").detach()[legal]
    )
    assert all_legal(out)


@pytest.mark.parametrize("replicas", [(), (3,)])
def test_average_is_the_mean_of_q_over_the_draws(replicas):
    actor, td = bayes_actor(replicas), observations(*replicas, 8)
    net, legal = actor[0].module, td["action_mask"]
    policy = EvaluationPolicy(actor, mode="average", num_draws=4)
    torch.manual_seed(0)
    out = policy(td.clone())
    torch.manual_seed(0)
    draws = [net.draw_weights() for _ in range(4)]
    expected = []
    for weights in draws:
        with weight_scope(weights={net: weights}), torch.no_grad():
            expected.append(net(td["observation"]))
    expected = torch.stack(expected).mean(0)
    torch.testing.assert_close(out["action_value"][legal], expected[legal])
    assert torch.equal(out["action"], torch.where(legal, expected, torch.finfo().min).argmax(-1))
    assert all_legal(out)


@pytest.mark.parametrize("mode", ["average", "draw"])
def test_draws_stay_until_resampled(mode):
    actor, td = bayes_actor((2,)), observations(2, 8)
    policy = EvaluationPolicy(actor, mode=mode)
    first = values(policy, td)
    assert torch.equal(values(policy, td), first)
    legal = td["action_mask"]
    # all rows act on the same draw (their sums may be rounded differently)
    torch.testing.assert_close(first[:, :1].expand_as(first)[legal], first[legal])
    assert not (first[0][legal[0]] == first[1][legal[1]]).any()  # the two networks do not
    policy.resample()
    assert not (values(policy, td)[legal] == first[legal]).any()


@pytest.mark.parametrize("replicas", [(), (3,)])
def test_thompson_acts_as_the_policy_that_trains_whatever_the_exploration_type(replicas):
    actor, td = bayes_actor(replicas), observations(*replicas, 8)
    policy = EvaluationPolicy(actor, mode="thompson")
    torch.manual_seed(0)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        drawn = policy(td.clone())
    torch.manual_seed(0)
    trained = ThompsonSampling(actor)(td.clone())

    assert torch.equal(drawn["action"], trained["action"])
    assert torch.equal(drawn["action_value"], trained["action_value"])
    assert not drawn["action_value"].requires_grad
    legal = td["action_mask"]
    assert not (values(policy, td)[legal] == drawn["action_value"][legal]).any()
    assert all_legal(drawn)


def test_settings_that_make_no_policy_are_refused():
    actor = bayes_actor()
    with pytest.raises(ValueError, match=r"mode must be one of \['mean', 'average', 'draw', 'th"):
        EvaluationPolicy(actor, mode="median")
    with pytest.raises(ValueError, match="num_draws must be at least 1, got 0"):
        EvaluationPolicy(actor, mode="average", num_draws=0)
    plain = q_actor(FlatMLP(5, ACTIONS), Categorical(ACTIONS))
    assert EvaluationPolicy(plain)(observations(3))["action"].shape == (3,)
    with pytest.raises(ValueError, match="network with Bayesian layers"):
        EvaluationPolicy(plain, mode="draw")
