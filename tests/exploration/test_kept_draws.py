"""The lifetime of a policy's draws, also where weights are synced as TorchRL does it."""

from functools import partial

import pytest
import torch
from q_actor import bayes_actor, heads_actor, noisy_actor, observations, values
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.exploration import (
    BootstrapSampling,
    EvaluationPolicy,
    NoisySampling,
    ThompsonSampling,
)

REPLICAS = [(), (3,)]
PER = ["step", "episode", "round"]


def thompson(replicas=(), shared=False, **settings):
    return ThompsonSampling(bayes_actor(replicas), shared=shared, **settings)


def heads(replicas=(), **settings):
    # enough heads that a row hardly ever draws the same one again
    return BootstrapSampling(heads_actor(replicas, heads=1000), **settings)


def noisy(replicas=(), shared=False, per="step"):
    return NoisySampling(noisy_actor(replicas), shared=shared)


def evaluated(replicas=(), mode="average", **_):
    return EvaluationPolicy(bayes_actor(replicas), mode=mode)


shared, shared_noise = partial(thompson, shared=True), partial(noisy, shared=True)
one_draw = partial(evaluated, mode="draw")
FOR_ALL_ROWS = (shared, shared_noise, evaluated, one_draw)
HOLDING = [(make, per) for make in (thompson, shared, heads) for per in PER]
KEPT = [
    *HOLDING,
    (noisy, "step"),
    (shared_noise, "step"),
    (evaluated, "round"),
    (one_draw, "round"),
]


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize(("make", "per"), KEPT)
def test_a_draw_is_kept_for_a_step_a_dialogue_or_a_round(make, per, replicas):
    policy, td = make(replicas, per=per), observations(*replicas, 40)
    first = values(policy, td)
    for rows in first.reshape(-1, 40):
        if make in FOR_ALL_ROWS:  # equal rows of a product may be rounded differently
            torch.testing.assert_close(rows, rows[:1].expand(40), rtol=0, atol=1e-4)
        else:
            assert torch.unique(rows).numel() > 30
    assert torch.equal(values(policy, td), first) == (per != "step")
    if replicas:
        assert torch.unique(first[:, 0]).numel() == 3
    begin = td.clone().set("is_init", torch.ones_like(td["is_init"]))
    assert torch.equal(values(policy, begin), first) == (per == "round")
    if make not in (noisy, shared_noise):
        before = values(policy, td)
        policy.resample()
        assert not torch.equal(values(policy, td), before)


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("make", [thompson, shared, heads])
def test_a_dialogue_keeps_its_draw_until_the_next_one_begins(make, replicas):
    key = ("agent", "is_init")
    policy, td = make(replicas, per="episode", init_key=key), observations(*replicas, 40)
    td[key] = td.pop("is_init")
    td = td.select(*policy.in_keys)
    first = values(policy, td)
    begins = (torch.arange(40) % 3 == 0).repeat(*replicas, 1).view(*replicas, 40)
    begins[0] = False  # the first row; the first replica, if there are some
    second = values(policy, td.clone().set(key, begins.unsqueeze(-1)))
    if make is shared:  # one draw, new for all rows of a replica in which one begins
        begins = begins.any(-1, keepdim=True).expand(*replicas, 40)
    assert torch.equal(second[~begins], first[~begins])
    # 13 or more rows begin; each draws the same head again with probability 1/1000
    assert (second[begins] != first[begins]).sum() > begins.sum() - 6
    assert torch.equal(values(policy, td), second)


@pytest.mark.parametrize("make", [thompson, heads])
def test_new_rows_are_new_dialogues(make):
    policy = make(per="episode")
    values(policy, observations(4))
    assert torch.unique(values(policy, observations(7))).numel() > 3
    assert make(per="round").in_keys == ["observation", "action_mask"]  # no beginnings


def test_a_new_draw_is_of_the_rows_own_replica():
    policy, td = thompson((3,), per="episode"), observations(3, 4)
    posterior = policy.actor[0].module.posterior
    with torch.no_grad():  # so narrow that a draw is the mean, which differs between replicas
        posterior.rho.fill_(-30.0)
        posterior.mu.normal_()
    first = values(policy, td)
    td["is_init"][:, 1:] = True
    torch.testing.assert_close(values(policy, td), first)


@pytest.mark.parametrize(("make", "per"), [*HOLDING, (noisy, "step")])
def test_it_explores_under_random_and_outside_of_a_context_only(make, per):
    policy, td = make(per=per), observations(40)
    with weight_scope("mean"), torch.no_grad():
        expected = policy.actor(td.clone())["action_value"][..., 2]
    for exploration in (ExplorationType.RANDOM, None):
        assert not torch.equal(values(policy, td, exploration), expected)
    for mode in ("DETERMINISTIC", "MEAN", "MODE"):
        assert torch.equal(values(policy, td, ExplorationType[mode]), expected)


@pytest.mark.parametrize("per", ["episode", "round"])
@pytest.mark.parametrize("make", [thompson, shared, heads, evaluated])
@pytest.mark.parametrize(
    "change",
    [
        lambda policy: policy.double(),
        lambda policy: policy.actor.double(),  # as a loss that shares it is cast, past the policy
        lambda policy: policy.to("meta"),
    ],
    ids=["cast", "network cast", "moved"],
)
def test_a_policy_that_is_cast_or_moved_acts_on_draws_made_there(make, per, change):
    policy, td = make(per=per), observations(40)
    values(policy, td)
    change(policy)
    weight = next(policy.parameters())
    td = td.to(weight.device)
    td["observation"] = td["observation"].to(weight.dtype)
    found = values(policy, td)
    assert (found.dtype, found.device) == (weight.dtype, weight.device)
    assert make is not heads or policy.heads.device == weight.device
    assert found.is_meta or torch.equal(values(policy, td), found)


@pytest.mark.parametrize("make", [thompson, shared, evaluated])
def test_a_policy_whose_state_was_loaded_acts_on_draws_of_it(make):
    policy, other, td = make(per="episode"), make(per="episode"), observations(40)
    with torch.no_grad():
        next(other.parameters()).fill_(50.0)
    before = values(policy, td)
    policy.load_state_dict(other.state_dict())
    assert (values(policy, td) - before).abs().max() > 50


@pytest.mark.parametrize("make", [thompson, evaluated, one_draw])
@pytest.mark.parametrize(
    "change",
    [
        lambda actor, new: TensorDict.from_module(actor).data.update_(new),
        lambda actor, new: new.to_module(actor),
    ],
    ids=["in place", "replaced"],
)
def test_draws_of_weights_that_were_synced_are_made_anew(make, change):
    policy, td = make(per="round"), observations(6)
    first = values(policy, td)
    assert torch.equal(values(policy, td), first)
    weights = TensorDict.from_module(policy).data.clone()
    change(policy, weights.apply(lambda weight: weight + 1e-3))
    second = values(policy, td)
    assert not (second == first).any()
    assert torch.equal(values(policy, td), second)


def test_an_episode_under_way_keeps_its_draw_while_weights_are_learned():
    policy, td = ThompsonSampling(bayes_actor(), per="episode"), observations(6)
    first = values(policy, td)
    TensorDict.from_module(policy).data.apply_(lambda weight: weight.add_(1.0))
    assert torch.equal(values(policy, td), first)
    td["is_init"] = ~td["is_init"]
    assert not (values(policy, td) == first).any()
