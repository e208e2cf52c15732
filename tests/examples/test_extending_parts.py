"""The parts of the example package: what its strategy, agents, reward and environment do."""

import doctest
import importlib

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, transitions
from tensordict import TensorDict
from torch import nn
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesMLP, weight_scope
from bbq_torchrl.networks import q_actor

pytestmark = pytest.mark.usefixtures("installed", "without_curves")


PARTS = ("ucb_policy", "langevin_adam", "epinet_mlp", "index_sampling", "visit_reward", "chain_env")
DEEP_SEA = ("deep_sea_env", "deep_sea_training", "deep_sea_results")


@pytest.mark.parametrize("name", [*(f"bbq_extending.{part}" for part in PARTS), *DEEP_SEA])
def test_the_example_in_a_docstring_is_true(name):
    module = importlib.import_module(name)
    torch.manual_seed(0)
    result = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert result.attempted > 2
    assert result.failed == 0


def test_the_upper_bound_is_the_mean_without_a_coefficient_and_prefers_spread_with_one():
    from bbq_extending.ucb_policy import UpperConfidence

    network = BayesMLP(2, 2, (), mean_init="zero")
    with torch.no_grad():  # of two actions of mean 0, the second one's weights are uncertain
        ((weight, bias),) = network.layout.unflatten(network.posterior.rho)
        weight.fill_(-20), bias.fill_(-20)
        weight[:, 1] = 1.0
    actor = q_actor(network, Categorical(2), action_mask_key=None)
    rows = TensorDict(observation=torch.ones(50, 2), batch_size=[50])
    policy = UpperConfidence(actor, coefficient=5.0, draws=30)
    assert (policy(rows.clone())["action"] == 1).all()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        greedy = policy(rows.clone())["action_value"]
    with weight_scope("mean"):
        assert torch.equal(greedy, actor(rows.clone())["action_value"])


def test_langevin_steps_are_those_of_the_paper():
    from bbq_extending.langevin_adam import LangevinAdam

    lr, bias = torch.tensor([0.1, 0.01]), 2.0
    weight = nn.Parameter(torch.tensor([[1.0, -2.0], [0.5, 3.0]]))
    expected, mean, square = weight.detach().clone(), torch.zeros(2, 2), torch.zeros(2, 2)
    optimizer = LangevinAdam([weight], 2, noisy=[], lr=lr, bias=bias)
    for share in (1.0, 1.0, 0.5):
        optimizer.scale_lr(share)
        optimizer.zero_grad()
        (weight**2).sum().backward()
        optimizer.step()
        gradient = 2 * expected
        mean, square = 0.9 * mean + 0.1 * gradient, 0.99 * square + 0.01 * gradient**2
        expected -= share * lr[:, None] * (gradient + bias * mean / (square + 1e-8).sqrt())
    assert torch.allclose(weight, expected)


def test_langevin_noise_has_the_temperature():
    from bbq_extending.langevin_adam import LangevinAdam

    weight = nn.Parameter(torch.zeros(2, 20_000))
    beta = torch.tensor([1e2, 1e4])
    optimizer = LangevinAdam([weight], 2, lr=1.0, inverse_temperature=beta)
    optimizer.scale_lr(0.5)
    (0 * weight).sum().backward()
    optimizer.step()
    assert weight.std(1).tolist() == pytest.approx([0.01**0.5, 0.0001**0.5], rel=0.03)


@pytest.fixture
def epinet(installed):
    """A network of two replicas that reads an index of four numbers."""
    from bbq_extending.epinet_mlp import EpinetMLP

    return EpinetMLP(FEATURES, ACTIONS, (8,), index_size=4, prior_scale=2.0, replicas=(2,))


def test_an_epinet_changes_values_by_the_index_and_leaves_the_base_network_alone(epinet):
    x, index = torch.randn(2, 5, FEATURES), torch.randn(2, 5, 4)
    base = epinet(x, torch.zeros(2, 5, 4))
    (epinet(x, index) - base).square().sum().backward()
    assert epinet.epinet.weight.grad.any()
    assert not epinet.trunk.weight.grad.any()
    assert not epinet.head.weight.grad.any()
    with torch.no_grad():  # what is left without the part that learns: the priors, linear in z
        _, (weight, bias) = epinet.epinet.layout.unflatten(epinet.epinet.weight)
        weight.zero_(), bias.zero_()
        once, twice = (epinet(x, factor * index) - base for factor in (1, 2))
    torch.testing.assert_close(twice, 2 * once)
    assert once.abs().max() > 0.1


def test_an_index_is_the_same_in_a_value_and_its_target(epinet):
    from bbq_extending.index_sampling import INDEX, IndexLoss

    keys = ("observation", INDEX)
    actor = q_actor(epinet, Categorical(ACTIONS), in_keys=keys, action_mask_key=None)
    loss = IndexLoss(actor, 4, gamma=0.5)
    HardUpdate(loss, value_network_update_interval=0)
    batch = transitions((2,), (6,))
    assert not loss.has_fixed_targets
    found = loss(batch)["loss_value"]
    index = batch["index"]
    assert index.flatten(0, 1).unique(dim=0).shape[0] == 12
    value = epinet(batch["observation"], index).gather(-1, batch["action"].unsqueeze(-1))
    following = epinet(batch["next", "observation"], index).amax(-1, keepdim=True)
    target = batch["next", "reward"] + 0.5 * following * ~batch["next", "terminated"]
    torch.testing.assert_close(found, (value - target).square().mean((1, 2)))
