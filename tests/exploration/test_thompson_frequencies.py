"""Thompson sampling takes an action with its posterior probability of being the best.

Every test compares counts of actions with the truth by a chi-square test, which fails at a p-value
below 1e-6: by chance once in a million runs.
"""

import pytest
import torch
from scipy import integrate, stats
from tensordict import TensorDict
from torchrl.data import Categorical

from bbq_torchrl.bayes import BayesLayer, BayesLinear
from bbq_torchrl.exploration import ThompsonSampling
from bbq_torchrl.networks import q_actor

FEATURES, ACTIONS, DRAWS = 4, 5, 4000
LEAST_P = 1e-6
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


def without_rare(taken, expected):
    """Returns both counts, each rare action counted together with the next rarest one."""
    pairs = sorted(zip(expected, taken, strict=True))
    while pairs[0][0] < 50:
        (first, ours), (second, theirs), *others = pairs
        pairs = sorted([(first + second, ours + theirs), *others])
    expected, taken = zip(*pairs, strict=True)
    return taken, expected


def probability_of_being_best(mean, std):
    """P(Q_a > Q_b for all b) for independent Gaussian Q, by quadrature."""

    def density(q, a):
        others = [b for b in range(len(mean)) if b != a]
        below = stats.norm.cdf(q, mean[others], std[others]).prod()
        return stats.norm.pdf(q, mean[a], std[a]) * below

    return [
        integrate.quad(density, mean[a] - 8 * std[a], mean[a] + 8 * std[a], (a,))[0]
        for a in range(len(mean))
    ]


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
    expected = probability_of_being_best(mean[mask].double().numpy(), std[mask].double().numpy())
    assert sum(expected) == pytest.approx(1.0)

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
    taken, expected = without_rare(taken[mask].tolist(), [DRAWS * p for p in expected])
    assert stats.chisquare(taken, expected, sum_check=False).pvalue > LEAST_P
