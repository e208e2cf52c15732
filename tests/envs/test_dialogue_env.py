"""The dialogue environment: specs, resets, seeds, state, settings, devices."""

import copy
import pickle
from dataclasses import replace

import pytest
import torch
from torchrl.envs import check_env_specs

from bbq_torchrl.domains import tensorize
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule
from bbq_torchrl.simulator import ErrorModel, Simulator
from bbq_torchrl.simulator.measured_errors import load_errors
from benchmarks.parts.host_waits import NeverWaits


def step(env, *names):
    """Plays one action in all dialogues, or one for each. Returns the observation."""
    actions = torch.tensor([env.domain.action_index(name) for name in names])
    return env.step(env.dialogues.select().set("action", actions.expand(env.batch_size)))["next"]


@pytest.mark.parametrize(
    ("domain_name", "batch_size", "schedule"),
    [
        ("movie", (), None),
        ("movie", (5,), ExtensionSchedule(start=1, every=1)),
        ("restaurant", (2, 3), None),
    ],
)
def test_specs_describe_what_the_environment_gives(domain_name, batch_size, schedule, request):
    domain = request.getfixturevalue(domain_name)
    env = DialogueEnv(domain, batch_size=batch_size, schedule=schedule, seed=0)
    check_env_specs(env)
    n_features = 2 * len(domain.acts) + 7 * len(domain.slots) + 3 + domain.turn_width
    widths = {"observation": n_features, "action_mask": len(domain.actions)}
    widths |= dict.fromkeys(("turns", "goal_id", "success", "done", "terminated", "truncated"), 1)
    for key, width in widths.items():
        assert env.fake_tensordict()[key].shape == (*batch_size, width), key
    assert (env.action_spec.shape, env.action_spec.n) == (batch_size, len(domain.actions))
    goals = env.observation_spec["goal_id"].space
    assert (goals.low == 0).all()
    assert (goals.high == len(domain.goals) - 1).all()


@pytest.mark.parametrize("batch_size", [(6,), (2, 3)])
def test_a_partial_reset_starts_those_dialogues_only(restaurant, batch_size):
    env = DialogueEnv(restaurant, batch_size=batch_size, seed=2)
    env.reset()
    step(env, "greeting")
    before, state = step(env, "request(area)"), env.dialogues.clone()
    which = torch.tensor([False, True, False, False, True, False]).view(*batch_size, 1)
    # TorchRL keeps entries that are not reset from the data that comes with the mask.
    after = env.reset(before.clone().set("_reset", which))
    mask = which.squeeze(-1)
    assert (after["turns"].squeeze(-1) == torch.where(mask, 0, 2)).all()
    assert not after["done"].any()
    kept = after.select("observation", "goal_id", "turns")[~mask]
    assert (kept == before.select(*kept.keys())[~mask]).all()
    assert (env.dialogues[~mask] == state[~mask]).all()
    assert (env.dialogues["turn"][mask] == 0).all()
    assert (env.dialogues["agent_act"][mask] == -1).all()


def make(restaurant, seed):
    schedule = ExtensionSchedule(start=1, every=1)
    return DialogueEnv(restaurant, batch_size=(2, 4), seed=seed, schedule=schedule, users="people")


def unpickled(env, _):
    return pickle.loads(pickle.dumps(env))


def loaded(env, tmp_path):
    torch.save(env.state_dict(), tmp_path / "env.pt")
    other = make(env.domain, 8)
    other.load_state_dict(torch.load(tmp_path / "env.pt", weights_only=True))
    return other


@pytest.mark.parametrize("copied", [loaded, unpickled, lambda env, _: copy.deepcopy(env)])
@pytest.mark.parametrize("turns", [None, 3])
def test_a_copy_goes_on_as_the_environment_does(restaurant, copied, turns, tmp_path):
    def play(env, count):
        torch.manual_seed(0)
        return [env.rand_step(env.dialogues.select()) for _ in range(count)]

    env = make(restaurant, 7)
    env.set_round(2)
    if turns is not None:
        env.reset()
        play(env, turns)
    other = copied(env, tmp_path)
    assert other.round == 2
    under_way = 0 if turns is None else 5
    for own, its in zip(play(env, under_way), play(other, under_way), strict=True):
        assert (own == its).all()
    assert (env.reset() == other.reset()).all()


def test_dialogues_of_another_batch_or_domain_are_refused(movie, restaurant):
    env = DialogueEnv(movie, batch_size=(3,), seed=0)
    env.reset()
    with pytest.raises(ValueError, match=r"batch size \[3\]"):
        DialogueEnv(movie, batch_size=(4,)).load_state_dict(env.state_dict())
    for domain in (restaurant, replace(movie, name="cinema")):
        with pytest.raises(ValueError, match="domain movie with 29 slots"):
            DialogueEnv(domain, batch_size=(3,)).load_state_dict(env.state_dict())


def test_what_is_told_is_not_memory_of_the_state(restaurant):
    env = DialogueEnv(restaurant, batch_size=(3,), seed=0)
    for tell in (env.reset, lambda: step(env, "greeting")):
        told, before = tell(), env.dialogues.clone()
        for value in told.values():
            value.fill_(1)
        assert (env.dialogues == before).all()


def test_the_domain_says_how_hard_it_is_unless_the_caller_does(movie):
    assert DialogueEnv(movie).simulator.errors.slot_error_prob == movie.reference_slot_error_prob
    assert DialogueEnv(movie, slot_error_prob=0.0).simulator.errors.slot_error_prob == 0.0


def test_settings_reach_the_simulator(restaurant):
    errors = {"slot_error_prob": 0.25, "slot_error_mode": "mixed", "intent_error_prob": 0.5}
    rewards = {"success_reward": 1.0, "failure_reward": -2.0, "turn_reward": -0.5}
    env = DialogueEnv(restaurant, batch_size=(2,), max_turn=10, **errors, **rewards)
    assert {name: getattr(env.simulator.errors, name) for name in errors} == errors
    assert env.max_agent_turns == 6
    env.reset()
    assert step(env, "greeting", "thanks")["reward"].flatten().tolist() == [-0.5, -2.0]
    assert env.simulator.rewards.success == 1.0


def test_what_an_environment_cannot_do_is_refused(restaurant):
    env = DialogueEnv(restaurant)
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        _ = env.dialogues
    with pytest.raises(ValueError, match=r"round .*-1"):
        env.set_round(-1)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device, BBQ_TEST_CUDA=1")
def test_an_environment_moves_to_an_accelerator_and_back(restaurant):
    env = DialogueEnv(restaurant, batch_size=(5,), seed=0)
    env.reset()
    goals = env.dialogues["goal_id"]
    env = env.to("cuda")
    assert torch.equal(env.dialogues["goal_id"].cpu(), goals)
    check_env_specs(env)
    state = env.state_dict()
    expected = env.reset()
    other = DialogueEnv(restaurant, batch_size=(5,), seed=1, device="cuda")
    other.load_state_dict(state)
    assert (other.reset() == expected).all()
    assert env.to("cpu").reset().device.type == "cpu"


def test_a_reset_may_choose_the_goal_and_leaves_all_else(restaurant):
    env, other = (DialogueEnv(restaurant, batch_size=(4,), seed=3) for _ in range(2))
    begun, drawn = env.reset(goal_id=2), other.reset()
    assert (begun["goal_id"] == 2).all()
    same = (drawn["goal_id"] == 2).squeeze(-1)
    assert torch.equal(begun["observation"][same], drawn["observation"][same])
    which = begun.clone().set("_reset", torch.tensor([[True], [False], [False], [True]]))
    assert env.reset(which, goal_id=0)["goal_id"].flatten().tolist() == [0, 2, 2, 0]
    other.reset()
    assert torch.equal(env.reset()["goal_id"], other.reset()["goal_id"])
    with pytest.raises(ValueError, match="goal_id must be an integer from 0 to 19, got 99"):
        env.reset(goal_id=99)


def test_neither_a_turn_nor_a_reset_waits_for_the_device(restaurant):
    env = make(restaurant, 0)
    state = env.reset()
    state["action"] = env.rand_action()["action"]
    state["_reset"] = torch.rand(2, 4, 1) < 0.5
    with NeverWaits():
        env._step(state)
        env._reset(state)
        env._reset()


@pytest.mark.parametrize("mode", ["mixed", "measured"])
def test_everything_that_a_turn_uses_is_on_its_device(movie, restaurant, mode):
    # Tensors on the device "meta" have no numbers: code that reads one, or mixes them with tensors
    # on the CPU, fails.
    domain = movie if mode == "measured" else restaurant
    tensors = tensorize(domain)
    errors = load_errors(domain) if mode == "measured" else ErrorModel(tensors, 0.3, mode, 0.2)
    simulator = Simulator(tensors, errors=errors, users="people").to("meta")
    active = torch.ones(tensors.n_slots, dtype=torch.bool, device="meta")
    action = torch.zeros(7, dtype=torch.int64, device="meta")
    with NeverWaits():
        state = simulator.reset(simulator.draw_reset((7,)), active)
        state = simulator.turn(state, action, simulator.draw_turn((7,)), active)
        features = simulator.observe(state, active)
    assert {features.device.type, *(entry.device.type for entry in state.values(True, True))} == {
        "meta"
    }
