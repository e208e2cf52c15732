"""Thompson sampling takes an action with its posterior probability of being the best.

Counts of actions may be off by six standard errors and three draws.
"""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical

from bbq_torchrl.bayes import BayesLayer, BayesLinear
from bbq_torchrl.exploration import ThompsonSampling
from bbq_torchrl.networks import q_actor
from bbq_torchrl.options import Task
from bbq_torchrl.options.explore import ThompsonBoltzmann

FEATURES, ACTIONS, DRAWS = 4, 5, 4000
COUNT = 20_000
# Many draws of one posterior: as rows with separate draws or, if a batch shares a draw, as replicas
# of equal networks.
WAYS = [("step", False), ("step", True), ("episode", False), ("round", False), ("round", True)]


class OwnLayer(BayesLinear):
    """A custom layer without local reparameterization."""

    run_local = BayesLayer.run_local


def away_from_the_prior(net):
    """Gives the network a random posterior, wide enough that several actions may be the best."""
    with torch.no_grad():
        net.posterior.mu.normal_(0, 0.15)
        net.posterior.rho.uniform_(-1, 0)
    return net


def assert_as_often(taken, probability):
    expected = taken.sum() * probability
    error = (expected * (1 - probability)).sqrt()
    assert ((taken - expected).abs() < 6 * error + 3).all()


@pytest.mark.parametrize(
    ("kind", "per", "shared"),
    [*((BayesLinear, *way) for way in WAYS), (OwnLayer, "step", False)],
)
@pytest.mark.parametrize("legal", [[True] * ACTIONS, [True, False, True, True, False]])
def test_a_linear_networks_action_is_taken_as_often_as_it_is_the_best(kind, per, shared, legal):
    # Q_a = w_a · x + b_a are independent Gaussians
    x = torch.randn(FEATURES)
    posterior = away_from_the_prior(BayesLinear(FEATURES, ACTIONS))
    ((matrix, bias),) = posterior.layout.unflatten(posterior.posterior.mu.detach())
    ((matrix_std, bias_std),) = posterior.layout.unflatten(posterior.posterior.sigma.detach())
    mean = x @ matrix + bias
    std = (x.square() @ matrix_std.square() + bias_std.square()).sqrt()
    mask = torch.tensor(legal)
    values = (mean + std * torch.randn(1_000_000, ACTIONS)).where(mask, -torch.inf)
    expected = values.argmax(-1).bincount(minlength=ACTIONS) / len(values)

    net = kind(FEATURES, ACTIONS, replicas=DRAWS if shared else ())
    with torch.no_grad():
        for ours, theirs in zip(net.parameters(), posterior.parameters(), strict=True):
            ours.copy_(theirs)
    policy = ThompsonSampling(q_actor(net, Categorical(ACTIONS)), per=per, shared=shared)
    batch = (DRAWS, 1) if shared else (DRAWS,)
    td = TensorDict(
        observation=x.expand(*batch, FEATURES),
        action_mask=mask.expand(*batch, ACTIONS),
        is_init=torch.zeros(*batch, 1, dtype=torch.bool),
        batch_size=batch,
    )
    taken = policy(td)["action"].flatten().bincount(minlength=ACTIONS)

    assert not taken[~mask].any()
    assert_as_often(taken, expected)


def softened(std, temperature):
    """The actor of a posterior, and ``explore=thompson_boltzmann`` on it."""
    torch.manual_seed(0)
    spec = Categorical(4)
    actor = q_actor(BayesLinear(2, 4, std_init=std), spec, action_mask_key="mask")
    task = Task(2, spec, replicas=1, rounds=10, device=torch.device("cpu"), action_mask_key="mask")
    chosen = ThompsonBoltzmann(temperature_init=temperature, temperature_end=temperature)
    policy, metrics = chosen.make(actor, actor, task)
    assert metrics["temperature"]() == pytest.approx(temperature)
    td = TensorDict(observation=torch.ones(COUNT, 2), batch_size=[COUNT])
    td["mask"] = torch.tensor([True, True, True, False]).expand(COUNT, -1)
    return actor, policy, td


def test_without_spread_thompson_boltzmann_is_boltzmann_of_the_mean():
    actor, policy, td = softened(std=1e-9, temperature=0.5)
    values = actor(td[:1].clone())["action_value"][0, :3]
    counts = policy(td)["action"].bincount(minlength=4)
    assert counts[3] == 0  # the masked one
    assert_as_often(counts[:3], (values / 0.5).softmax(-1))


def test_at_a_low_temperature_thompson_boltzmann_is_thompson_sampling():
    _, policy, td = softened(std=0.5, temperature=1e-6)
    acted = policy(td)
    values = acted["action_value"].where(acted["mask"], float("-inf"))
    assert torch.equal(acted["action"], values.argmax(-1))
    assert len(acted["action"].unique()) == 3
