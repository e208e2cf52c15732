"""How long a policy acts on what it has drawn: weights, or one of its heads."""

from __future__ import annotations

import pytest
import torch
from q_actor import ACTIONS, FEATURES, bayes_actor, observations, values
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.exploration import (
    BootstrapSampling,
    EvaluationPolicy,
    NoisySampling,
    ThompsonSampling,
)
from bbq_torchrl.networks import BootstrapMLP, NoisyMLP, bootstrap_actor, q_actor

REPLICAS = [(), (3,)]
HEADS = 1000  # so many that a row hardly ever draws the same head again


def thompson(replicas=(), **settings):
    return ThompsonSampling(bayes_actor(replicas), shared=False, **settings)


def shared(replicas=(), **settings):
    return ThompsonSampling(bayes_actor(replicas), shared=True, **settings)


def heads(replicas=(), **settings):
    network = BootstrapMLP(FEATURES, ACTIONS, (8,), heads=HEADS, replicas=replicas)
    return BootstrapSampling(bootstrap_actor(network, Categorical(ACTIONS)), **settings)


def noisy(replicas=(), shared=False, **_):
    network = NoisyMLP(FEATURES, ACTIONS, (16,), replicas=replicas)
    return NoisySampling(q_actor(network, Categorical(ACTIONS)), shared=shared)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("per", ["step", "episode", "round"])
@pytest.mark.parametrize("make", [thompson, shared, heads])
def test_a_draw_is_kept_for_a_step_a_dialogue_or_a_round(make, per, replicas):
    policy, td = make(replicas, per=per), observations(*replicas, 40)
    first = values(policy, td)
    for rows in first.reshape(-1, 40):
        if make is shared:  # equal rows of a matrix product may be rounded differently
            torch.testing.assert_close(rows, rows[:1].expand(40), rtol=0, atol=1e-4)
        else:
            assert torch.unique(rows).numel() > 30
    assert torch.equal(values(policy, td), first) == (per != "step")
    if replicas:
        assert torch.unique(first[:, 0]).numel() == 3
    begin = td.clone().set("is_init", torch.ones_like(td["is_init"]))
    assert torch.equal(values(policy, begin), first) == (per == "round")
    before = values(policy, td)
    policy.resample()
    assert not torch.equal(values(policy, td), before)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("per", ["step", "episode", "round"])
@pytest.mark.parametrize("make", [thompson, shared, heads])
def test_no_rows_get_no_actions(make, per, replicas):
    out = make(replicas, per=per)(observations(*replicas, 0))
    assert out["action"].shape == (*replicas, 0)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("together", [False, True])
def test_rows_have_one_noise_or_each_its_own(replicas, together):
    found = values(noisy(replicas, shared=together), observations(*replicas, 40))
    for rows in found.reshape(-1, 40):
        if together:
            torch.testing.assert_close(rows, rows[:1].expand(40), rtol=0, atol=1e-4)
        else:
            assert torch.unique(rows).numel() == 40


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("make", [thompson, heads])
def test_a_dialogue_keeps_its_draw_until_the_next_one_begins(make, replicas):
    policy, td = make(replicas, per="episode"), observations(*replicas, 40)
    first = values(policy, td)
    begins = (torch.arange(40) % 3 == 0).expand(*replicas, 40)
    second = values(policy, td.clone().set("is_init", begins.unsqueeze(-1)))
    assert torch.equal(second[~begins], first[~begins])
    # 14 or 42 rows begin; each draws the same head again with probability 1/1000.
    assert (second[begins] != first[begins]).sum() > begins.sum() - 6
    assert torch.equal(values(policy, td), second)


@pytest.mark.parametrize("make", [thompson, shared, heads])
def test_a_single_dialogue_keeps_its_draw_too(make):
    policy, td = make(per="episode"), observations()
    first = values(policy, td)
    assert torch.equal(values(policy, td), first)
    td["is_init"] = torch.ones(1, dtype=torch.bool)
    assert len({float(values(policy, td)) for _ in range(10)}) > 5


@pytest.mark.parametrize("make", [thompson, heads])
def test_new_rows_are_new_dialogues(make):
    policy = make(per="episode")
    values(policy, observations(4))
    assert torch.unique(values(policy, observations(7))).numel() > 3


@pytest.mark.parametrize("make", [thompson, shared, heads, noisy])
@pytest.mark.parametrize("per", ["step", "episode", "round"])
def test_it_explores_under_random_and_outside_of_a_context_only(make, per):
    policy, td = make(per=per), observations(40)
    drawn = (values(policy, td, exploration) for exploration in (ExplorationType.RANDOM, None))
    modes = ("DETERMINISTIC", "MEAN", "MODE")
    means = [values(policy, td, ExplorationType[mode]) for mode in modes]
    with weight_scope("mean"), torch.no_grad():
        expected = policy.actor(td.clone())["action_value"][..., 2]
    for mean in means:
        assert torch.equal(mean, expected)
    for own in drawn:
        assert not torch.equal(own, expected)


def evaluated(**_):
    return EvaluationPolicy(bayes_actor(), mode="average")


@pytest.mark.parametrize("make", [thompson, heads])
def test_a_dialogues_beginning_is_among_what_a_policy_reads_if_it_does(make):
    policy, td = make(per="episode", init_key=("agent", "is_init")), observations(40)
    td["agent", "is_init"] = td.pop("is_init")
    values(policy, td.select(*policy.in_keys))
    assert make(per="round").in_keys == ["observation", "action_mask"]


@pytest.mark.parametrize("make", [thompson, shared, evaluated])
def test_a_policy_that_is_cast_acts_on_draws_of_its_new_dtype(make):
    policy, td = make(per="episode"), observations(40)
    values(policy, td)
    td["observation"] = td["observation"].double()
    found = values(policy.double(), td)
    assert found.dtype == torch.float64
    assert torch.equal(values(policy, td), found)


@pytest.mark.parametrize("per", ["episode", "round"])
@pytest.mark.parametrize("make", [thompson, shared, evaluated])
def test_a_network_that_is_cast_where_a_policy_holds_draws_is_acted_on(make, per):
    policy, td = make(per=per), observations(40)
    values(policy, td)
    policy.actor.double()  # as a loss that shares it is cast, past the policy
    td["observation"] = td["observation"].double()
    assert values(policy, td).dtype == torch.float64


@pytest.mark.parametrize("make", [thompson, shared, evaluated])
def test_a_policy_whose_state_was_loaded_acts_on_draws_of_it(make):
    policy, other, td = make(per="episode"), make(per="episode"), observations(40)
    with torch.no_grad():
        next(other.parameters()).fill_(50.0)
    before = values(policy, td)
    policy.load_state_dict(other.state_dict())
    assert (values(policy, td) - before).abs().max() > 50


@pytest.mark.parametrize("make", [ThompsonSampling, EvaluationPolicy])
def test_a_network_that_is_no_actor_is_refused(make):
    with pytest.raises(ValueError, match=r"such as q_actor makes of a network, got BayesMLP"):
        make(bayes_actor()[0].module)


@pytest.mark.parametrize("make", [thompson, shared, heads, evaluated])
def test_a_policy_that_is_moved_acts_on_draws_made_there(make):
    policy, td = make(per="round"), observations(40)
    values(policy, td)
    assert values(policy.to("meta"), td.to("meta")).device.type == "meta"
    assert make is not heads or policy.heads.device.type == "meta"


@pytest.mark.parametrize("per", ["episode", "round"])
@pytest.mark.parametrize("make", [thompson, shared, heads])
def test_draws_of_inference_mode_are_acted_on_and_redrawn_outside_of_it(make, per):
    policy, td = make(per=per), observations(40)
    with torch.inference_mode():
        first = values(policy, td)
    assert torch.equal(values(policy, td), first)
    td["is_init"][0] = True
    values(policy, td)
