"""Actors that are sequences of modules: nested, convolutional, recurrent."""

from __future__ import annotations

import pytest
import torch
from q_transitions import away
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Categorical, OneHot
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import EGreedyModule, QValueActor, QValueModule
from torchrl.objectives import DQNLoss, HardUpdate

from bbq_torchrl.bayes import BayesConv2d, BayesGRU, BayesLinear, BayesMLP, kl_divergence
from bbq_torchrl.exploration import (
    BootstrapSampling,
    EvaluationPolicy,
    Greedy,
    MajorityVote,
    NoisySampling,
    ThompsonSampling,
)
from bbq_torchrl.networks import BootstrapMLP, FlatMLP, NoisyMLP, ReplicaNoisyLinear
from bbq_torchrl.networks.vote import VoteModule
from bbq_torchrl.objectives import BBQNLoss, BootstrapDQNLoss, DropoutDQNLoss, NoisyDQNLoss

ROWS, ACTIONS, HIDDEN = 6, 4, 8
PIXELS = {"observation": (2, 6, 5)}
FEATURES = {"observation": (3,)}
RECURRENT = {**FEATURES, "state": (HIDDEN,)}
MASKED = Categorical(ACTIONS)


def module(net, read, write):
    return TensorDictModule(net, read, write)


def choice():
    return QValueModule(action_space="categorical", action_mask_key="action_mask")


def head(kind=BayesLinear, read="hidden"):
    return module(kind(HIDDEN, ACTIONS), [read], ["action_value"])


def convolutional(linear=BayesLinear, conv=BayesConv2d):
    net = nn.Sequential(conv(2, 3, 3), nn.ReLU(), nn.Flatten(-3), linear(36, HIDDEN), nn.ReLU())
    trunk = module(net, ["observation"], ["hidden"])
    return TensorDictSequential(trunk, head(linear), choice())


def recurrent(gru=BayesGRU, linear=BayesLinear):
    trunk = module(gru(3, HIDDEN), ["observation", "state"], ["hidden", ("next", "state")])
    return TensorDictSequential(trunk, head(linear), choice())


def nested():
    trunk = module(nn.Linear(3, HIDDEN), ["observation"], ["hidden"])
    explore = EGreedyModule(Categorical(ACTIONS), 0.0, 0.0, action_mask_key="action_mask")
    actor = QValueActor(
        head().module, in_keys=["hidden"], spec=MASKED, action_mask_key="action_mask"
    )
    return TensorDictSequential(TensorDictSequential(trunk, actor), explore)


class Cell(nn.GRUCell):
    def forward(self, x, state):
        new = super().forward(x, state)
        return new, new


ACTORS = {
    "convolutional": (convolutional, PIXELS),
    "recurrent": (recurrent, RECURRENT),
    "nested": (nested, FEATURES),
}
PLAIN = {
    "convolutional": (lambda: convolutional(nn.Linear, nn.Conv2d), PIXELS),
    "recurrent": (lambda: recurrent(Cell, nn.Linear), RECURRENT),
}


def states(shapes):
    mask = torch.rand(ROWS, ACTIONS) < 0.5
    mask[:, 1] = True
    return {"action_mask": mask, **{key: torch.randn(ROWS, *s) for key, s in shapes.items()}}


def transitions(shapes):
    ends = torch.rand(ROWS, 1) < 0.3
    end = {"reward": torch.randn(ROWS, 1), "terminated": ends, "done": ends}
    td = TensorDict({**states(shapes), "next": {**states(shapes), **end}}, [ROWS])
    td["action"] = torch.ones(ROWS).long()
    return td


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", PLAIN)
def test_the_loss_is_torchrls_dqn_loss(name, double):
    make, shapes = PLAIN[name]
    actor, td = make(), transitions(shapes)
    ours, _ = away(DropoutDQNLoss(actor, action_space="categorical", double_dqn=double, gamma=0.9))
    theirs = DQNLoss(actor, action_space="categorical", delay_value=True, double_dqn=double)
    theirs.make_value_estimator(gamma=0.9)
    HardUpdate(theirs, value_network_update_interval=0)
    theirs.target_value_network_params.update_(ours.target_value_network_params)

    if "state" in shapes:  # TorchRL's goes on from the state that it has just computed
        td["next", "state"] = actor(td.select("observation", "state", "action_mask"))[
            "next", "state"
        ].detach()
    torch.testing.assert_close(ours(td.copy())["loss"], theirs(td.copy())["loss"])


@pytest.mark.parametrize(
    "settings", [{}, {"target": "mc"}, {"target": "mc", "hold": True}], ids=str
)
@pytest.mark.parametrize("name", ACTORS)
def test_bbqn_learns_all_of_an_actor(name, settings):
    make, shapes = ACTORS[name]
    actor = make()
    loss, _ = away(BBQNLoss(actor, action_space="categorical", num_data=100, **settings))
    out = loss(transitions(shapes))
    torch.testing.assert_close(out["kl"], kl_divergence(actor))
    out["loss"].backward()
    assert all(p.grad.isfinite().all() and p.grad.any() for p in loss.parameters())
    if loss.has_fixed_targets:
        assert loss.next_state_values(transitions(shapes)).shape == (ROWS, 1)


def test_bootstrap_and_noisy_losses_and_policies_take_sequences():
    trunk = module(Cell(3, HIDDEN), ["observation", "state"], ["hidden", ("next", "state")])
    heads = module(BootstrapMLP(HIDDEN, ACTIONS, (), heads=3), ["hidden"], ["head_value"])
    actor = TensorDictSequential(trunk, heads, VoteModule(Categorical(ACTIONS)))
    td = transitions(RECURRENT)
    td["bootstrap_mask"] = torch.rand(ROWS, 3) < 0.5
    loss, _ = away(BootstrapDQNLoss(actor, action_space="categorical"))
    td["observation"][~td["bootstrap_mask"].any(-1)] = torch.nan
    loss(td)["loss"].backward()
    assert all(p.grad.isfinite().all() for p in loss.parameters())
    td = TensorDict(states(RECURRENT), [ROWS])
    for policy in (MajorityVote(actor), BootstrapSampling(actor, per="step")):
        out = policy(td.clone())
        assert out["action_mask"].gather(-1, out["action"].unsqueeze(-1)).all()
        assert out["next", "state"].shape == (ROWS, HIDDEN)  # where the next step goes on

    actor = recurrent(Cell, ReplicaNoisyLinear)
    loss, _ = away(NoisyDQNLoss(actor, action_space="categorical"))
    loss(transitions(RECURRENT))["loss"].backward()
    first, second = (NoisySampling(actor)(td.clone())["action_value"] for _ in range(2))
    assert not torch.equal(first, second)


@pytest.mark.parametrize("name", ACTORS)
def test_every_strategy_and_evaluation_acts_on_it(name):
    make, shapes = ACTORS[name]
    actor = make()
    td = TensorDict(states(shapes), [ROWS])
    td["is_init"] = torch.zeros(ROWS, 1, dtype=torch.bool)
    policies = {"greedy": Greedy(actor)}
    for per in ("step", "episode", "round"):
        for shared in (False, True):
            policies[f"thompson {per} {shared}"] = ThompsonSampling(actor, per=per, shared=shared)
    for mode in ("mean", "average", "draw", "thompson"):
        policies[mode] = EvaluationPolicy(actor, mode=mode, num_draws=3)
    for what, policy in policies.items():
        with set_exploration_type(ExplorationType.RANDOM):
            first, second = policy(td.clone()), policy(td.clone())
        assert first["action_mask"].gather(-1, first["action"].unsqueeze(-1)).all(), what
        same = torch.equal(first["action_value"], second["action_value"])
        assert same == ("step" not in what and what != "thompson"), what
        assert policy.spec is None  # TensorDictSequential has none
        if "state" in shapes:
            assert first["next", "state"].shape == (ROWS, HIDDEN)


@pytest.mark.parametrize("kind", [ThompsonSampling, BootstrapSampling])
def test_an_episode_needs_to_know_where_it_begins(kind):
    if kind is ThompsonSampling:
        actor = nested()
    else:
        heads = module(BootstrapMLP(3, ACTIONS), ["observation"], ["head_value"])
        actor = TensorDictSequential(heads, VoteModule(Categorical(ACTIONS)))
    td = TensorDict(states(FEATURES), [ROWS])
    policy = kind(actor, per="episode")
    with pytest.raises(ValueError, match=r"per='episode' needs the entry 'is_init'.*InitTracker"):
        policy(td)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        policy(td)  # where nothing is drawn, nothing is missing


@pytest.mark.parametrize("spec", [Categorical(ACTIONS), OneHot(ACTIONS)], ids=["index", "one-hot"])
@pytest.mark.parametrize(
    ("loss", "net"),
    [
        (DropoutDQNLoss, FlatMLP),
        (BBQNLoss, BayesMLP),
        (BootstrapDQNLoss, BootstrapMLP),
        (NoisyDQNLoss, NoisyMLP),
    ],
)
def test_a_bare_network_learns_with_the_spec_of_its_action(loss, net, spec):
    settings = {"num_data": 100} if loss is BBQNLoss else {}
    made, _ = away(loss(net(3, ACTIONS), action_space=spec, **settings))
    batch = TensorDict({"observation": torch.randn(ROWS, 3)}, [ROWS])
    batch["action"] = spec.rand([ROWS])
    end = {"reward": torch.randn(ROWS, 1), "terminated": torch.zeros(ROWS, 1, dtype=torch.bool)}
    batch["next"] = {"observation": torch.randn(ROWS, 3), **end}
    made(batch)["loss"].backward()
    assert any(parameter.grad is not None for parameter in made.parameters())


class Own(nn.Module):
    """A network of one's own: a matrix for each replica."""

    def __init__(self, replicas):
        super().__init__()
        self.weight = nn.Parameter(torch.randn(2, 3, ACTIONS))
        self.replicas = replicas

    def forward(self, observation):
        return observation @ self.weight


@pytest.mark.parametrize("replicas", [2, (2,), [2], torch.Size([2])])
def test_a_network_says_its_replicas_by_a_number_or_a_shape(replicas):
    actor = QValueActor(Own(replicas), in_keys=["observation"], spec=Categorical(ACTIONS))
    assert DropoutDQNLoss(actor).replicas == (2,)


@pytest.mark.parametrize("replicas", ["2", 2.0, (2.0,), torch.tensor(2)])
def test_other_replicas_are_refused(replicas):
    actor = QValueActor(Own(replicas), in_keys=["observation"], spec=Categorical(ACTIONS))
    with pytest.raises(
        ValueError,
        match=r"^a network's replicas must be an integer or a tuple of integers, got .*2",
    ):
        DropoutDQNLoss(actor)
