"""An agent's values of its actions, and its reasons."""

import pytest
import torch

from bbq_torchrl.people.chat import TrainedAgent


@pytest.fixture
def observation(agents):
    return torch.rand(agents["bbqn"].simulator.layout.size)


@pytest.mark.parametrize(("name", "legal"), [("bbqn", 39), ("bootstrap", 19)])
def test_bands_hold_the_mean_and_chances_of_what_is_legal_add_up_to_one(
    agents, observation, name, legal
):
    noise = torch.get_rng_state()
    found = agents[name].beliefs(observation, seed=3)
    assert torch.equal(torch.get_rng_state(), noise)
    assert len(found.actions) == legal
    assert sum(item.p_best for item in found.actions) == pytest.approx(1)
    means = [item.mean for item in found.actions]
    assert means == sorted(means, reverse=True)
    for item in found.actions:
        assert item.band90[0] <= item.band50[0] <= item.band50[1] <= item.band90[1]
        assert item.band90[0] <= item.mean <= item.band90[1]
    assert found == agents[name].beliefs(observation, seed=3)


def test_an_agent_without_a_posterior_has_values_and_no_bands(agents, observation):
    agent = agents["dqn"]
    assert agent.beliefs(observation, seed=0) is None
    values = agent.values(observation, seed=0)
    assert next(iter(values)) == str(agent.domain.actions[agent.decide(observation, 0)])


@pytest.mark.parametrize("name", ["bbqn", "dqn", "bootstrap"])
def test_reasons_add_up_to_the_difference_of_the_two_actions(agents, observation, name):
    agent = agents[name]
    found = agent.reasons(observation, seed=1)
    assert found.action == str(agent.domain.actions[agent.decide(observation, 1)])
    assert found.other != found.action
    assert sum(part.mean for part in found.parts) == pytest.approx(found.difference.mean, abs=5e-3)
    low, high = found.difference.band90
    assert (low == high) == (name == "dqn")


def test_replicas_and_weights_have_fingerprints_of_their_own(runs, agents):
    first, second = agents["bbqn"].fingerprint(), TrainedAgent(runs / "bbqn", replica=1)
    assert len({first, second.fingerprint()}) == 2
    again = TrainedAgent(runs / "bbqn")
    assert again.fingerprint() == first
    with torch.no_grad():
        next(again._policy.parameters()).add_(1e-3)
    assert again.fingerprint() != first


def test_a_replica_that_is_not_there_is_refused(runs):
    with pytest.raises(ValueError, match="replica must be between 0 and 1 for"):
        TrainedAgent(runs / "bbqn", replica=2)
