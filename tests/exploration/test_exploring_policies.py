"""What every exploring policy does, and Thompson sampling, greedy and Boltzmann policies."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from q_actor import ACTIONS, FEATURES, all_legal, bayes_actor, observations, values
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.data import Categorical, OneHot
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import EGreedyModule

from bbq_torchrl.exploration import (
    Boltzmann,
    BootstrapSampling,
    Greedy,
    MajorityVote,
    NoisySampling,
    ThompsonSampling,
)
from bbq_torchrl.networks import BootstrapMLP, FlatMLP, NoisyMLP, bootstrap_actor, q_actor

RANDOM, DETERMINISTIC = ExplorationType.RANDOM, ExplorationType.DETERMINISTIC
REPLICAS = [(), (3,)]


def is_one_number(rows):
    """Whether rows agree; equal rows of a matrix product may be rounded differently."""
    return bool((rows - rows.flatten()[0]).abs().max() < 1e-4)


def test_draws_are_the_papers_by_default():
    actor = bayes_actor()
    assert ThompsonSampling(actor).per == "step"
    assert not ThompsonSampling(actor).shared
    assert not ThompsonSampling(actor, per="episode").shared
    assert ThompsonSampling(actor, per="round").shared


def test_a_shared_dialogue_draw_changes_where_any_row_of_the_element_begins():
    policy = ThompsonSampling(bayes_actor((3,)), per="episode", shared=True)
    td = observations(3, 4)
    td["is_init"] = torch.zeros(3, 4, 1, dtype=torch.bool)
    first = values(policy, td)
    td["is_init"][1, 2] = True
    second = values(policy, td)
    assert torch.equal(second[[0, 2]], first[[0, 2]])
    assert not (second[1] == first[1]).any()
    assert is_one_number(second[1])


def test_a_new_draw_is_of_the_rows_own_replica():
    actor = bayes_actor((3,))
    with torch.no_grad():  # so narrow that a draw is the mean, which differs between replicas
        actor[0].module.posterior.rho.fill_(-30.0)
        actor[0].module.posterior.mu.normal_()
    policy, td = ThompsonSampling(actor, per="episode"), observations(3, 4)
    first = values(policy, td)
    td["is_init"][:, 1:] = True
    torch.testing.assert_close(values(policy, td), first)


def policies(replicas):
    actor, spec = bayes_actor(replicas), Categorical(ACTIONS)
    epsilon = EGreedyModule(spec, 0.5, 0.5, action_mask_key="action_mask")
    noisy = q_actor(NoisyMLP(FEATURES, ACTIONS, (16,), replicas=replicas), spec)
    heads = bootstrap_actor(BootstrapMLP(FEATURES, ACTIONS, (8,), replicas=replicas), spec)
    made = {
        "greedy": Greedy(actor),
        "epsilon": TensorDictSequential(Greedy(actor), epsilon),
        "thompson epsilon": TensorDictSequential(ThompsonSampling(actor), epsilon),
        "boltzmann": TensorDictSequential(Greedy(actor), Boltzmann(5.0, 1.0, 10)),
        "noisy epsilon": TensorDictSequential(NoisySampling(noisy), epsilon),
        "vote": MajorityVote(heads),
        "vote epsilon": TensorDictSequential(MajorityVote(heads), epsilon),
    }
    for per in ("step", "episode", "round"):
        made[f"heads {per}"] = BootstrapSampling(heads, per=per)
        for shared in (False, True):
            made[f"thompson {per} {shared}"] = ThompsonSampling(actor, per=per, shared=shared)
    for shared in (False, True):
        made[f"noisy {shared}"] = NoisySampling(noisy, shared=shared)
    return made


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("name", list(policies(())))
@pytest.mark.parametrize("exploration", [RANDOM, DETERMINISTIC, None])
def test_no_strategy_takes_a_forbidden_action(replicas, name, exploration):
    policy = policies(replicas)[name]
    with set_exploration_type(exploration):
        for _ in range(3):
            td = policy(observations(*replicas, 200, same=False))
            assert td["action"].shape == (*replicas, 200)
            assert td["action"].dtype == torch.int64
            assert all_legal(td)


def test_greedy_is_greedy_under_every_exploration_type_and_without_dropout():
    net = FlatMLP(5, ACTIONS, (32,), dropout=0.5)
    td, policy = observations(20), Greedy(q_actor(net, Categorical(ACTIONS)))
    expected = net(td["observation"], "mean")
    for exploration in (RANDOM, DETERMINISTIC, None):
        with set_exploration_type(exploration):
            out = policy(td.clone())
        torch.testing.assert_close(
            out["action_value"][td["action_mask"]], expected[td["action_mask"]]
        )


def test_boltzmann_draws_from_the_softmax_over_legal_actions():
    n, explore = 40_000, Boltzmann(2.0, 1.0, 10)
    q = torch.tensor([1.0, 3.0, 50.0, -1.0])
    mask = torch.tensor([True, True, False, True])
    td = TensorDict({"action_value": q.expand(n, 4), "action_mask": mask.expand(n, 4)}, [n])
    with set_exploration_type(RANDOM):
        share = explore(td)["action"].bincount(minlength=4) / n
    expected = torch.softmax(q[mask] / 2, 0)
    assert share[2] == 0
    assert (share[mask] - expected).abs().max() < 5 * (0.25 / n) ** 0.5


def test_boltzmann_survives_any_scale_of_q():
    for scale in (0.0, 1e-30, 1e6, 1e30):
        q = scale * torch.randn(500, 4)
        mask = torch.tensor([True, True, False, True]).expand(500, 4)
        with set_exploration_type(RANDOM):
            td = Boltzmann(1e-3, 1e-3, 1)(TensorDict(action_value=q, action_mask=mask))
        assert all_legal(td)


def test_boltzmann_leaves_the_action_when_it_is_not_to_explore():
    td = TensorDict({"action_value": torch.randn(9, 4), "action": torch.arange(9) % 4}, [9])
    with set_exploration_type(DETERMINISTIC):
        out = Boltzmann(1.0, 1.0, 1, action_mask_key=None)(td.clone())
    assert torch.equal(out["action"], td["action"])


@pytest.mark.parametrize("spec", [Categorical(3), OneHot(3)])
def test_boltzmann_draws_an_action_in_the_form_of_the_greedy_one(spec):
    network = torch.nn.Linear(2, 3)
    actor = q_actor(network, spec, action_mask_key=None)
    policy = TensorDictSequential(actor, Boltzmann(1e6, 1e6, 1, action_mask_key=None))
    with set_exploration_type(RANDOM):
        action = policy(TensorDict(observation=torch.ones(300, 2), batch_size=[300]))["action"]
    assert spec.expand(300, *spec.shape).is_in(action.to(spec.dtype))
    # 300 draws at so high a temperature miss one of three actions with probability 1e-52
    assert action.unique(dim=0).shape[0] == 3


def test_boltzmann_anneals_linearly():
    explore = Boltzmann(5.0, 1.0, 8)
    seen = []
    for _ in range(10):
        explore.step()
        seen.append(float(explore.temperature))
    assert seen == pytest.approx([4.5, 4, 3.5, 3, 2.5, 2, 1.5, 1, 1, 1])


def test_what_a_strategy_needs_is_named():
    plain = q_actor(FlatMLP(5, ACTIONS), Categorical(ACTIONS))
    with pytest.raises(ValueError, match="network with Bayesian layers"):
        ThompsonSampling(plain)
    with pytest.raises(ValueError, match="NoisyNet needs a network with noisy layers"):
        NoisySampling(plain)
    with pytest.raises(ValueError, match="action_key must be 'action' or end in it, got 'act'"):
        q_actor(FlatMLP(5, ACTIONS), Categorical(ACTIONS), action_key="act")
    with pytest.raises(ValueError, match=r"per must be one of \['step', 'episode', 'round'\]"):
        ThompsonSampling(bayes_actor(), per="game")


@pytest.mark.parametrize("name", list(policies(())))
def test_policies_have_specs_keys_and_copies_with_networks_of_their_own(name):
    policy, td = policies((3,))[name], observations(3, 4)
    assert {"observation", "action_mask"} <= set(policy.in_keys)
    assert "action" in policy.out_keys
    if not isinstance(policy, TensorDictSequential):
        assert policy.spec["action"] == Categorical(ACTIONS)
    values(policy, td)  # where draws are held, the copy holds the same
    found = []
    for made in (policy, deepcopy(policy)):
        torch.manual_seed(0)
        found.append(values(made, td))
        with torch.no_grad():
            for parameter in made.parameters():
                parameter.add_(1.0)
    assert torch.equal(*found)
