"""``explore=thompson_boltzmann`` draws weights, then an action from the softmax of their values."""

import pytest
import torch
from scipy import stats
from tensordict import TensorDict
from torchrl.data import Categorical

from bbq_torchrl.bayes import BayesLinear
from bbq_torchrl.networks import q_actor
from bbq_torchrl.options import Task
from bbq_torchrl.options.explore import ThompsonBoltzmann

ACTIONS, DRAWS = 4, 20_000


def made(std: float, temperature: float):
    """The actor of a posterior and its strategy."""
    torch.manual_seed(0)
    spec = Categorical(ACTIONS)
    actor = q_actor(BayesLinear(2, ACTIONS, std_init=std), spec, action_mask_key="mask")
    task = Task(2, spec, replicas=1, rounds=10, device=torch.device("cpu"), action_mask_key="mask")
    chosen = ThompsonBoltzmann(temperature_init=temperature, temperature_end=temperature)
    policy, metrics = chosen.make(actor, actor, task)
    assert metrics["temperature"]() == pytest.approx(temperature)
    td = TensorDict(observation=torch.ones(DRAWS, 2), batch_size=[DRAWS])
    td["mask"] = torch.tensor([True, True, True, False]).expand(DRAWS, -1)
    return actor, policy, td


def test_without_spread_it_is_boltzmann_of_the_mean():
    """A chi-square test, which fails by chance once in a million."""
    actor, policy, td = made(std=1e-9, temperature=0.5)
    values = actor(td[:1].clone())["action_value"][0, :3].double()
    expected = DRAWS * (values / 0.5).softmax(-1)
    counts = policy(td)["action"].bincount(minlength=ACTIONS)
    assert counts[3] == 0  # the masked one
    assert stats.chisquare(counts[:3], expected.detach()).pvalue > 1e-6


def test_at_a_low_temperature_it_is_thompson_sampling():
    _, policy, td = made(std=0.5, temperature=1e-6)
    acted = policy(td)
    values = acted["action_value"].where(acted["mask"], float("-inf"))
    assert torch.equal(acted["action"], values.argmax(-1))
    assert len(acted["action"].unique()) == 3
