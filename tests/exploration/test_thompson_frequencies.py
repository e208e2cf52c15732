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


@pytest.mark.parametrize(
    ("kind", "per", "shared"),
    [*((BayesLinear, *way) for way in WAYS), (OwnLayer, "step", False)],
)
@pytest.mark.parametrize("legal", [[True] * ACTIONS, [True, False, True, True, False]])
def test_a_linear_networks_action_is_taken_as_often_as_it_is_the_best(kind, per, shared, legal):
    # Q_a = w_a · x + b_a are independent Gaussians
    x = torch.randn(FEATURES)
    posterior = BayesLinear(FEATURES, ACTIONS)
    with torch.no_grad():  # so wide that several actions may be the best
        posterior.posterior.mu.normal_(0, 0.15)
        posterior.posterior.rho.uniform_(-1, 0)
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
    often = DRAWS * expected
    error = (often * (1 - expected)).sqrt()
    assert ((taken - often).abs() < 6 * error + 3).all()


def test_thompson_boltzmann_softens_the_values_of_each_rows_draw():
    spec, temperature = Categorical(4), 0.5
    actor = q_actor(BayesLinear(2, 4, std_init=0.5), spec)
    task = Task(2, spec, replicas=1, rounds=10, device=torch.device("cpu"))
    chosen = ThompsonBoltzmann(temperature_init=temperature, temperature_end=temperature)
    policy, metrics = chosen.make(actor, actor, task)
    assert metrics["temperature"]() == pytest.approx(temperature)
    mask = torch.tensor([True, True, True, False]).expand(COUNT, -1)
    td = TensorDict(observation=torch.ones(COUNT, 2), action_mask=mask, batch_size=[COUNT])
    acted = policy(td)
    drawn = acted["action_value"].where(mask, -torch.inf)
    assert (drawn[:, :3].std(0) > 0.1).all()
    chances = (drawn / temperature).softmax(-1)
    taken = acted["action"].bincount(minlength=4)
    error = (chances * (1 - chances)).sum(0).sqrt()
    assert ((taken - chances.sum(0)).abs() <= 6 * error).all()
