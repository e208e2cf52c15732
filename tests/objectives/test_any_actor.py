"""Custom actors: nested sequences of modules, and recurrent ones."""

import pytest
import q_transitions
import torch
from q_actor import all_legal, policies_of
from q_transitions import ACTIONS, away, result
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import EGreedyModule, QValueActor, QValueModule

from bbq_torchrl.bayes import BayesLinear, GaussianPosterior, kl_divergence
from bbq_torchrl.networks import BootstrapMLP, ReplicaNoisyLinear
from bbq_torchrl.networks.bootstrap import VoteModule
from bbq_torchrl.objectives import BBQNLoss, BootstrapDQNLoss, NoisyDQNLoss

ROWS, HIDDEN = 20, 8
SPEC = Categorical(ACTIONS)


def transitions():
    """Transitions of 60 features, with a recurrent state for recurrent actors."""
    td = q_transitions.transitions(batch=(ROWS,), features=60)
    td["state"], td["next", "state"] = torch.randn(2, ROWS, HIDDEN)
    return td


class Gain(nn.Module):
    """A module that only contains a posterior."""

    def __init__(self, features):
        super().__init__()
        self.posterior = GaussianPosterior([features], 0.5)

    def forward(self, x):
        return x * self.posterior.weights()


class Cell(nn.Module):
    """A recurrent layer."""

    def __init__(self, linear):
        super().__init__()
        self.layer = linear(60 + HIDDEN, HIDDEN)

    def forward(self, x, state):
        new = self.layer(torch.cat([x, state], -1)).tanh()
        return new, new


def recurrent(linear=BayesLinear):
    keys = ["observation", "state"], ["hidden", ("next", "state")]
    return TensorDictSequential(
        TensorDictModule(Cell(linear), *keys),
        TensorDictModule(linear(HIDDEN, ACTIONS), ["hidden"], ["action_value"]),
        QValueModule(action_space="categorical", action_mask_key="action_mask"),
    )


def noisy():
    return recurrent(ReplicaNoisyLinear)


def heads():
    trunk, *_ = recurrent(nn.Linear)
    net = BootstrapMLP(HIDDEN, ACTIONS, (), heads=3)
    values = TensorDictModule(net, ["hidden"], ["head_value"])
    return TensorDictSequential(trunk, values, VoteModule(SPEC))


def nested():
    trunk = TensorDictModule(nn.Linear(60, HIDDEN), ["observation"], ["hidden"])
    explore = EGreedyModule(SPEC, 0.0, 0.0, action_mask_key="action_mask")
    net = nn.Sequential(BayesLinear(HIDDEN, ACTIONS), Gain(ACTIONS))
    actor = QValueActor(net, in_keys=["hidden"], spec=SPEC, action_mask_key="action_mask")
    return TensorDictSequential(TensorDictSequential(trunk, actor), explore)


BAYESIAN = [recurrent, nested]


@pytest.mark.parametrize(
    ("make", "kind", "settings"),
    [
        *(
            (make, BBQNLoss, {"num_data": 100, **settings})
            for make in BAYESIAN
            for settings in ({}, {"target": "mc"}, {"target": "mc", "cache": True})
        ),
        (heads, BootstrapDQNLoss, {}),
        (noisy, NoisyDQNLoss, {}),
    ],
)
def test_a_loss_learns_all_of_an_actor(make, kind, settings):
    actor, td = make(), transitions()
    loss, _ = away(kind(actor, action_space="categorical", **settings))
    td["valid"] = torch.arange(ROWS) > 0
    td["observation"][0] = torch.nan
    out = result(loss, td)
    out["loss"].backward()
    assert all(p.grad.isfinite().all() and p.grad.any() for p in loss.parameters())
    if kind is BBQNLoss:
        posteriors = [part for part in actor.modules() if isinstance(part, GaussianPosterior)]
        torch.testing.assert_close(out["kl"], sum(part.kl() for part in posteriors))
        torch.testing.assert_close(out["kl"], kl_divergence(actor))


@pytest.mark.parametrize("bayesian", BAYESIAN)
def test_every_policy_acts_on_it(bayesian):
    td = transitions().select("observation", "state", "action_mask")
    td["is_init"] = torch.zeros(ROWS, 1).bool()
    changing = set()
    for name, policy in policies_of(bayesian(), noisy(), heads(), SPEC).items():
        with set_exploration_type(ExplorationType.RANDOM):
            first, second = policy(td.clone()), policy(td.clone())
        assert all_legal(first), name
        if not torch.equal(first["action_value"], second["action_value"]):
            changing.add(name)
        if "state" in policy.in_keys:  # where the next step goes on
            assert first["next", "state"].shape == (ROWS, HIDDEN), name
    assert changing == {
        *("thompson step False", "thompson step True", "thompson epsilon", "evaluation thompson"),
        *("noisy False", "noisy True", "noisy epsilon", "heads step"),
    }
