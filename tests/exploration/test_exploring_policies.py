"""Thompson sampling, Boltzmann, greedy and epsilon-greedy policies."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from q_actor import ACTIONS, all_legal, bayes_actor, observations
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import EGreedyModule

from bbq_torchrl.exploration import Boltzmann, Greedy, ThompsonSampling
from bbq_torchrl.networks import FlatMLP, q_actor

RANDOM, DETERMINISTIC = ExplorationType.RANDOM, ExplorationType.DETERMINISTIC
REPLICAS = [(), (3,)]


def values(policy, td):
    with set_exploration_type(RANDOM):
        # action 2 is always legal
        return policy(td.clone())["action_value"][..., 2].detach()


def is_one_number(rows):
    """Whether rows agree; equal rows of a matrix product may be rounded differently."""
    return bool((rows - rows.flatten()[0]).abs().max() < 1e-4)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize(
    ("per", "shared", "rows_share", "calls_share"),
    [
        ("step", False, False, False),
        ("step", True, True, False),
        ("episode", False, False, True),
        ("episode", True, True, True),
        ("round", False, False, True),
        ("round", True, True, True),
    ],
)
def test_who_shares_a_draw(replicas, per, shared, rows_share, calls_share):
    policy = ThompsonSampling(bayes_actor(replicas), per=per, shared=shared)
    td = observations(*replicas, 4)
    first, again = values(policy, td), values(policy, td)
    for element in first.reshape(-1, 4):
        assert is_one_number(element) == rows_share
        assert rows_share or torch.unique(element).numel() == 4
    assert torch.equal(first, again) == calls_share
    if replicas:  # replicas never share
        assert torch.unique(first[:, 0]).numel() == 3
    policy.resample()
    assert not (values(policy, td) == first).any()


def test_draws_are_the_papers_by_default():
    actor = bayes_actor()
    assert ThompsonSampling(actor).per == "step"
    assert not ThompsonSampling(actor).shared
    assert not ThompsonSampling(actor, per="episode").shared
    assert ThompsonSampling(actor, per="round").shared


@pytest.mark.parametrize("replicas", REPLICAS)
def test_a_dialogue_keeps_its_draw_until_the_next_one_begins(replicas):
    policy = ThompsonSampling(bayes_actor(replicas), per="episode")
    td = observations(*replicas, 4)
    td["is_init"] = torch.ones(*replicas, 4, 1, dtype=torch.bool)
    first = values(policy, td)
    td["is_init"] = torch.zeros(*replicas, 4, 1, dtype=torch.bool)
    assert torch.equal(values(policy, td), first)
    td["is_init"][..., 1, :] = True
    second = values(policy, td)
    begins = td["is_init"].squeeze(-1)
    assert torch.equal(second[~begins], first[~begins])
    assert not (second[begins] == first[begins]).any()
    td["is_init"].zero_()
    assert torch.equal(values(policy, td), second)


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


def test_a_single_dialogue_keeps_its_draw_until_the_next_one_begins():
    for shared in (False, True):
        policy = ThompsonSampling(bayes_actor(), per="episode", shared=shared)
        td = observations()
        td["is_init"] = torch.zeros(1, dtype=torch.bool)
        first = values(policy, td)
        assert torch.equal(values(policy, td), first)
        td["is_init"] = torch.ones(1, dtype=torch.bool)
        assert not torch.equal(values(policy, td), first)


def test_new_rows_are_new_dialogues():
    policy = ThompsonSampling(bayes_actor(), per="episode")
    values(policy, observations(4))
    assert torch.unique(values(policy, observations(7))).numel() == 7


def test_own_draws_of_rows_are_uncorrelated_and_spread_as_the_posterior():
    actor = bayes_actor()
    n, td = 4000, observations(4000)
    weights = actor[0].module.draw_weights((n,))
    expected = actor[0].module(td["observation"], weights=weights)[:, 2].detach()
    policies = [ThompsonSampling(actor), ThompsonSampling(actor, per="episode")]
    for rows in [values(policy, td) for policy in policies]:
        assert abs(torch.corrcoef(torch.stack([rows[1:], rows[:-1]]))[0, 1]) < 5 * n**-0.5
        # kurtosis of a sum of products of Gaussians over 16 units: below 8
        assert rows.std() / expected.std() == pytest.approx(1, abs=5 * (2 * 8 / (4 * n)) ** 0.5)


@pytest.mark.parametrize("per", ["step", "episode", "round"])
def test_thompson_sampling_explores_under_random_and_outside_of_a_context_only(per):
    policy = ThompsonSampling(bayes_actor(), per=per)
    td = observations(4)
    assert policy(td.clone())["action_value"][..., 2].any()
    for mode in (DETERMINISTIC, ExplorationType.MEAN, ExplorationType.MODE):
        with set_exploration_type(mode):
            assert not policy(td.clone())["action_value"][..., 2].any()  # the mean network is 0


def test_thompson_sampling_acts_on_the_parameters_of_the_moment():
    actor = bayes_actor()
    policy, td = ThompsonSampling(actor, per="round"), observations(4)
    with torch.no_grad():
        actor[0].module.posterior.rho.fill_(-20.0)
        actor[0].module.posterior.mu.fill_(0.5)
    with set_exploration_type(DETERMINISTIC):
        expected = policy(td.clone())["action_value"][..., 2]
    torch.testing.assert_close(values(policy, td), expected)


def policies(replicas):
    actor = bayes_actor(replicas)
    spec = Categorical(ACTIONS)
    eps = {"eps_init": 0.5, "eps_end": 0.5, "action_mask_key": "action_mask"}
    made = {
        f"thompson {per} {shared}": ThompsonSampling(actor, per=per, shared=shared)
        for per in ("step", "episode", "round")
        for shared in (False, True)
    }
    made["greedy"] = Greedy(actor)
    made["epsilon"] = TensorDictSequential(Greedy(actor), EGreedyModule(spec, **eps))
    made["thompson epsilon"] = TensorDictSequential(
        ThompsonSampling(actor), EGreedyModule(spec, **eps)
    )
    made["boltzmann"] = TensorDictSequential(Greedy(actor), Boltzmann(5.0, 1.0, 10))
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


def test_epsilon_greedy_explores_its_share_of_rows():
    actor, n = bayes_actor(), 20_000
    with torch.no_grad():
        actor[0].module.posterior.mu.normal_()
    explore = EGreedyModule(
        Categorical(ACTIONS), eps_init=0.3, eps_end=0.3, action_mask_key="action_mask"
    )
    td = observations(n)
    legal = int(td["action_mask"][0].sum())
    with set_exploration_type(RANDOM):
        greedy = Greedy(actor)(td.clone())["action"]
        share = (explore(Greedy(actor)(td))["action"] != greedy).float().mean()
    expected = 0.3 * (1 - 1 / legal)
    assert abs(share - expected) < 5 * (0.25 / n) ** 0.5 + 1e-6


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


def test_boltzmann_anneals_linearly_and_keeps_the_temperature_in_its_state():
    explore = Boltzmann(5.0, 1.0, 8)
    seen = []
    for _ in range(10):
        explore.step()
        seen.append(float(explore.temperature))
    assert seen == pytest.approx([4.5, 4, 3.5, 3, 2.5, 2, 1.5, 1, 1, 1])
    jumped = Boltzmann(5.0, 1.0, 8)
    jumped.step(3)
    assert float(jumped.temperature) == pytest.approx(3.5)
    other = Boltzmann(5.0, 1.0, 8)
    other.load_state_dict(jumped.state_dict())
    assert torch.equal(other.temperature, jumped.temperature)


@pytest.mark.parametrize(("init", "end"), [(1.0, 2.0), (1.0, 0.0), (1.0, -1.0)])
def test_a_temperature_that_is_no_schedule_is_refused(init, end):
    with pytest.raises(ValueError, match="temperature_init must be at least temperature_end"):
        Boltzmann(init, end, 10)
    with pytest.raises(ValueError, match="annealing_num_steps must be at least 1, got 0"):
        Boltzmann(1.0, 1.0, 0)


def test_thompson_sampling_needs_a_posterior():
    with pytest.raises(ValueError, match="network with Bayesian layers"):
        ThompsonSampling(q_actor(FlatMLP(5, ACTIONS), Categorical(ACTIONS)))
    with pytest.raises(ValueError, match=r"per must be one of \['step', 'episode', 'round'\]"):
        ThompsonSampling(bayes_actor(), per="game")


@pytest.mark.parametrize("name", list(policies(())))
def test_policies_have_specs_keys_copies_and_states(name):
    policy = policies((3,))[name]
    assert {"observation", "action_mask"} <= set(policy.in_keys)
    assert "action" in policy.out_keys
    if not isinstance(policy, TensorDictSequential):
        assert policy.spec["action"] == Categorical(ACTIONS)
    td = observations(3, 4)
    with set_exploration_type(RANDOM):
        policy(td.clone())
    copy = deepcopy(policy)
    with set_exploration_type(DETERMINISTIC):
        assert torch.equal(copy(td.clone())["action"], policy(td.clone())["action"])
    copy.load_state_dict(policy.state_dict())


def test_a_copy_of_a_policy_acts_on_its_own_network():
    policy, td = ThompsonSampling(bayes_actor(), per="round"), observations(4)
    before = values(policy, td)
    copy = deepcopy(policy)
    assert torch.equal(values(copy, td), before)  # the draw is copied, too
    with torch.no_grad():
        copy.actor[0].module.posterior.mu.add_(1.0)
    copy.resample()
    assert torch.equal(values(policy, td), before)
