"""A Gaussian process on features next to exact ones, and its draws next to their moments."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.networks import GaussianProcess, q_actor
from bbq_torchrl.networks.gaussian_process import StateFeatures
from bbq_torchrl.objectives import GPLoss

FEATURES, ACTIONS, ROWS = 5, 3, 40
PRIOR_STD, NOISE_STD, VALUE_STD = 1.5, 0.7, 2.5


def angle(x, y):
    """Cho and Saul's kernel of degree 1 of (x, 1) and (y, 1), twice, from its definition."""
    x, y = (torch.cat([s, torch.ones(len(s), 1)], 1) for s in (x, y))
    cosine = (x @ y.T) / torch.outer(x.norm(dim=1), y.norm(dim=1))
    for _ in range(2):
        theta = torch.arccos(cosine.clamp(-1, 1))
        cosine = (torch.sin(theta) + (math.pi - theta) * torch.cos(theta)) / math.pi
    return cosine


def gaussian(x, y, length):
    return torch.exp(-((x[:, None] - y[None]) ** 2).sum(-1) / (2 * length**2))


def episodes(rows=ROWS, replicas=()):
    """Transitions of one step each, whose targets are their rewards."""
    shape = (*replicas, rows)
    ends = {"reward": torch.randn(*shape, 1), "terminated": torch.ones(*shape, 1).bool()}
    states = torch.randn(*shape, FEATURES)
    return TensorDict(
        observation=states,
        action=torch.randint(ACTIONS, shape),
        next={"observation": states, **ends},
        batch_size=shape,
    )


def fitted(features, data, **settings):
    network = GaussianProcess(features, ACTIONS, prior_std=PRIOR_STD)
    actor = q_actor(network, Categorical(ACTIONS), action_mask_key=None)
    GPLoss(actor, **{"noise_std": NOISE_STD, "value_std": VALUE_STD, **settings}).fit(data)
    return network


def covariance(network, states):
    """The covariance of a draw's values of each action, [A, N, N], from its linear map."""
    weights = torch.eye(network.posterior.mu.shape[-1])
    with torch.no_grad():
        mean = network(states, "mean")
        values = network(states.expand(len(weights), *states.shape), weights=weights) - mean
    return torch.einsum("pna,pma->anm", values, values)


@pytest.mark.parametrize("kernel", ["arccos", "rbf"])
def test_with_all_states_as_inducing_states_it_is_an_exact_gaussian_process(kernel):
    data, unseen = episodes(), torch.randn(7, FEATURES)
    data["action"][data["action"] == 2] = 1  # of one there is no data
    network = fitted(StateFeatures(FEATURES, ROWS, kernel=kernel, lengthscale=0.8), data)

    seen, reward = data["observation"], data["next", "reward"].squeeze(-1)
    length = 0.8 * torch.pdist(seen).median()

    def k(x, y):
        return angle(x, y) if kernel == "arccos" else gaussian(x, y, length)

    noise = NOISE_STD**2 * torch.eye(ROWS)
    at_rewards = torch.linalg.solve(VALUE_STD**2 * k(seen, seen) + noise, reward)
    shared = [VALUE_STD**2 * k(x, seen) @ at_rewards for x in (seen, unseen)]
    with torch.no_grad():
        means = network(unseen, "mean")
    variances = covariance(network, unseen).diagonal(dim1=-2, dim2=-1)
    for action in range(ACTIONS):
        rows = data["action"] == action
        own = PRIOR_STD**2 * k(seen[rows], seen[rows]) + noise[rows][:, rows]
        cross = PRIOR_STD**2 * k(unseen, seen[rows])
        mean = shared[1] + cross @ torch.linalg.solve(own, (reward - shared[0])[rows])
        variance = PRIOR_STD**2 - (cross * torch.linalg.solve(own, cross.T).T).sum(-1)
        torch.testing.assert_close(means[:, action], mean, rtol=0, atol=1e-3)
        torch.testing.assert_close(variances[action], variance, rtol=0, atol=1e-3)


@pytest.mark.parametrize("replicas", [(), (2,), (2, 3)])
def test_draws_for_each_row_have_the_moments_of_weight_draws(replicas):
    """Both are draws of one Gaussian: each mean and variance within five standard errors."""
    features = StateFeatures(FEATURES, 10, replicas=replicas)
    network, count = fitted(features, episodes(replicas=replicas)), 4_000
    state = torch.randn(FEATURES)
    with torch.no_grad():
        local = network(state.expand(*replicas, count, FEATURES), "local")
        with weight_scope(weights={network: network.draw_weights((count,))}):
            drawn = network(state.expand(*replicas, count, 1, FEATURES)).squeeze(-2)
        mean = network(state.expand(*replicas, 1, FEATURES), "mean").squeeze(-2)
    variance = (local.var(-2) + drawn.var(-2)) / 2
    for values in (local, drawn):
        assert ((values.mean(-2) - mean).abs() < 5 * (variance / count).sqrt()).all()
        assert ((values.var(-2) / variance - 1).abs() < 5 * math.sqrt(2 / count)).all()
