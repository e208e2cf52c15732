"""The dialogue environment by itself: specs, resets, seeds, state."""

from __future__ import annotations

import copy
import pickle
import re
from dataclasses import replace
from functools import partial

import pytest
import torch
from torchrl.envs import check_env_specs

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, scripted_policy
from bbq_torchrl.envs.measured import load_errors


def step(env, action):
    td = env.dialogues.select().set("action", action)
    return env.step(td)["next"]


@pytest.mark.parametrize("domain_name", ["movie", "restaurant"])
@pytest.mark.parametrize("batch_size", [(), (5,), (2, 3)])
@pytest.mark.parametrize("schedule", [None, ExtensionSchedule(start=1, every=1)])
def test_specs_describe_what_the_environment_gives(domain_name, batch_size, schedule, request):
    domain = request.getfixturevalue(domain_name)
    env = DialogueEnv(domain, batch_size=batch_size, schedule=schedule, seed=0)
    check_env_specs(env)
    n_features = 2 * len(domain.acts) + 7 * len(domain.slots) + 3 + domain.turn_width
    documented = {
        "observation": ((n_features,), torch.float32),
        "action_mask": ((len(domain.actions),), torch.bool),
        "success": ((1,), torch.bool),
        "turns": ((1,), torch.int64),
        "goal_id": ((1,), torch.int64),
        "done": ((1,), torch.bool),
        "terminated": ((1,), torch.bool),
        "truncated": ((1,), torch.bool),
    }
    given = env.fake_tensordict()
    for where in (given, given["next"]):
        for key, (shape, dtype) in documented.items():
            assert where[key].shape == (*batch_size, *shape), key
            assert where[key].dtype == dtype, key
    assert given["next", "reward"].shape == (*batch_size, 1)
    assert (env.action_spec.shape, env.action_spec.n) == (batch_size, len(domain.actions))


@pytest.mark.parametrize("batch_size", [(6,), (2, 3)])
def test_a_partial_reset_starts_those_dialogues_only(movie, batch_size):
    env = DialogueEnv(movie, batch_size=batch_size, seed=2)
    env.reset()
    for name in ("greeting", "request(city)"):
        before = step(env, torch.full(batch_size, movie.action_index(name)))
    state = env.dialogues.clone()
    which = torch.zeros(*batch_size, 1, dtype=torch.bool)
    which.view(-1)[1] = which.view(-1)[4] = True
    # TorchRL keeps what is not reset from the data that comes with the mask.
    after = env.reset(before.clone().set("_reset", which))
    mask = which.squeeze(-1)

    assert after["observation"].shape == before["observation"].shape
    assert (after["turns"].squeeze(-1) == torch.where(mask, 0, 2)).all()
    assert not after["done"].any()
    for key in ("observation", "goal_id", "turns"):
        assert torch.equal(after[key][~mask], before[key][~mask]), key
    for key in state.keys():  # noqa: SIM118  (a TensorDict iterates over its rows)
        assert torch.equal(env.dialogues[key][~mask], state[key][~mask]), key
    assert (env.dialogues["turn"][mask] == 0).all()
    assert (env.dialogues["agent_act"][mask] == -1).all()


def test_the_seed_decides_everything_but_the_policy(movie):
    def rollout(env):
        torch.manual_seed(0)
        return env.rollout(10, scripted_policy("random", env), break_when_any_done=False)

    make = partial(DialogueEnv, movie, batch_size=(8,), intent_error_prob=0.2)
    one = rollout(make(seed=5))
    assert (one == rollout(make(seed=5))).all()
    env = make(seed=6)
    assert not torch.equal(one["observation"], rollout(env)["observation"])
    assert env.set_seed(5) != 5
    assert (one == rollout(env)).all()


@pytest.mark.parametrize("channel", [None, load_errors])
def test_dialogues_do_not_depend_on_the_default_dtype(movie, channel):
    def rollout():
        own = None if channel is None else channel(movie)
        env = DialogueEnv(movie, batch_size=(8,), channel=own, seed=5)
        return env.rollout(10, scripted_policy("rule", env), break_when_any_done=False)

    expected = rollout()
    torch.set_default_dtype(torch.float64)
    try:
        found = rollout()
    finally:
        torch.set_default_dtype(torch.float32)
    assert (found == expected).all()
    for key in ("observation", ("next", "reward")):
        assert found[key].dtype == torch.float32


def test_without_a_seed_torch_manual_seed_decides(movie):
    def first():
        return DialogueEnv(movie, batch_size=(8,)).reset()["goal_id"]

    torch.manual_seed(1)
    one, other = first(), first()
    assert not torch.equal(one, other)
    torch.manual_seed(1)
    assert torch.equal(first(), one)


@pytest.mark.parametrize("turns", [0, 3])
def test_a_saved_environment_goes_on_as_if_nothing_had_happened(movie, turns, tmp_path):
    def make(seed):
        schedule = ExtensionSchedule(start=1, every=1)
        return DialogueEnv(movie, batch_size=(2, 4), seed=seed, schedule=schedule)

    def play(env, count):
        torch.manual_seed(0)
        return [env.rand_step(env.dialogues.select()) for _ in range(count)]

    env = make(7)
    env.set_round(2)
    env.reset()
    play(env, turns)
    torch.save(env.state_dict(), tmp_path / "env.pt")
    expected = play(env, 5)
    started = env.reset()

    loaded = make(8)
    loaded.load_state_dict(torch.load(tmp_path / "env.pt", weights_only=True))
    assert loaded.round == 2
    for one, other in zip(play(loaded, 5), expected, strict=True):
        assert (one == other).all()
    assert (loaded.reset() == started).all()


def test_an_environment_is_saved_before_its_first_reset(movie):
    env, other = DialogueEnv(movie, seed=9), DialogueEnv(movie, seed=10)
    other.load_state_dict(env.state_dict())
    assert (other.reset() == env.reset()).all()


def test_dialogues_of_another_batch_are_refused(movie):
    env = DialogueEnv(movie, batch_size=(3,), seed=0)
    env.reset()
    other = DialogueEnv(movie, batch_size=(4,), seed=0)
    with pytest.raises(ValueError, match=r"saved dialogues have batch size \[3\]"):
        other.load_state_dict(env.state_dict())


def test_dialogues_of_another_domain_are_refused(movie, restaurant):
    env = DialogueEnv(movie, batch_size=(3,), seed=0)
    env.reset()
    other = replace(movie, name="cinema")
    for domain in (restaurant, other):
        with pytest.raises(ValueError, match="are of domain movie with 29 slots, the environment"):
            DialogueEnv(domain, batch_size=(3,)).load_state_dict(env.state_dict())


def test_what_is_told_is_not_memory_of_the_state(movie):
    env = DialogueEnv(movie, batch_size=(3,), seed=0)
    greeting = torch.full((3,), movie.action_index("greeting"))
    for tell in (env.reset, lambda: step(env, greeting)):
        told, before = tell(), env.dialogues.clone()
        for key in ("success", "turns", "goal_id", "done", "terminated", "truncated", "reward"):
            if key in told:
                told[key].fill_(1)
        assert (env.dialogues == before).all()


def test_a_copy_and_a_pickle_go_on_alike(movie):
    env = DialogueEnv(movie, batch_size=(4,), seed=11)
    env.reset()
    copies = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    action = torch.full((4,), movie.action_index("confirm_answer"))
    expected = step(env, action)
    for other in copies:
        assert (step(other, action) == expected).all()


def test_the_domain_says_how_hard_it_is_unless_the_caller_does(movie):
    assert DialogueEnv(movie).simulator.errors.slot_error_prob == movie.reference_slot_error_prob
    assert DialogueEnv(movie, slot_error_prob=0.0).simulator.errors.slot_error_prob == 0.0


def test_settings_reach_the_simulator(movie):
    env = DialogueEnv(
        movie,
        batch_size=(2,),
        slot_error_prob=0.25,
        slot_error_mode="mixed",
        intent_error_prob=0.5,
        max_turn=10,
        success_reward=1.0,
        failure_reward=-2.0,
        turn_reward=-0.5,
    )
    errors = env.simulator.errors
    assert (errors.slot_error_prob, errors.slot_error_mode) == (0.25, "mixed")
    assert errors.intent_error_prob == 0.5
    assert env.max_agent_turns == 6
    env.reset()
    greeting, thanks = movie.action_index("greeting"), movie.action_index("thanks")
    td = step(env, torch.tensor([greeting, thanks]))
    assert td["reward"].flatten().tolist() == [-0.5, -2.0]
    assert env.simulator.rewards.success == 1.0


def test_dialogues_before_the_first_reset_are_refused(movie):
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        _ = DialogueEnv(movie).dialogues


@pytest.mark.parametrize("batch_size", [5, (0,), (3, 0), (-1,)])
def test_a_batch_of_no_dialogues_is_refused(movie, batch_size):
    message = (
        f"batch_size must be a sequence of numbers above 0, .* got {re.escape(str(batch_size))}"
    )
    with pytest.raises(ValueError, match=message):
        DialogueEnv(movie, batch_size=batch_size)


def test_an_unknown_device_is_refused(movie):
    with pytest.raises(ValueError, match="device must be one that is present, got 'nowhere'"):
        DialogueEnv(movie, device="nowhere")


@pytest.mark.skipif(torch.cuda.is_available(), reason="needs a machine without CUDA")
def test_an_absent_cuda_device_is_refused(movie):
    with pytest.raises(ValueError, match="device must be one that is present, got 'cuda'"):
        DialogueEnv(movie, device="cuda")
    with pytest.raises(ValueError, match="device must be one that is present, got 'cuda:1'"):
        DialogueEnv(movie).to("cuda:1")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_an_environment_moves_to_an_accelerator_and_back(movie):
    env = DialogueEnv(movie, batch_size=(5,), seed=0)
    env.reset()
    goals = env.dialogues["goal_id"]
    env = env.to("cuda")
    assert env.dialogues.device.type == "cuda"
    assert torch.equal(env.dialogues["goal_id"].cpu(), goals)
    check_env_specs(env)
    state = env.state_dict()
    expected = env.reset()
    other = DialogueEnv(movie, batch_size=(5,), seed=1, device="cuda")
    other.load_state_dict(state)
    assert (other.reset() == expected).all()
    assert env.to("cpu").reset().device.type == "cpu"
