"""The policies of one posterior: mean network, average of draws, one draw, new draws."""

import pytest
import torch
from q_actor import bayes_actor, observations
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl.exploration import EvaluationPolicy, ThompsonSampling

REPLICAS = [(), (3,)]


def legal_values(policy, td):
    return policy(td.clone())["action_value"][td["action_mask"]]


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


@pytest.mark.parametrize("replicas", REPLICAS)
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
    assert not (legal_values(policy, td) == drawn["action_value"][legal]).any()
