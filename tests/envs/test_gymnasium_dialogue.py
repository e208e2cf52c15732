"""The Gymnasium environment: Gymnasium's checker, and the same dialogues as DialogueEnv."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ActionMask, GymEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule
from bbq_torchrl.networks import q_actor

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.error import ResetNeeded  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

from bbq_torchrl.envs.gymnasium import ENV_ID  # noqa: E402


@pytest.fixture
def env(restaurant):
    return gymnasium.make(ENV_ID, domain=restaurant).unwrapped


def goals_of(env, seed=None, count=8):
    """Returns the goals of the environment's next dialogues, the first of them seeded."""
    return [env.reset(seed=seed if n == 0 else None)[1]["goal_id"] for n in range(count)]


@pytest.mark.parametrize("mask_in_observation", [False, True])
def test_gymnasiums_checker_has_nothing_to_say(mask_in_observation):
    env = gymnasium.make(ENV_ID, mask_in_observation=mask_in_observation)
    check_env(env.unwrapped)  # a warning would be an error


def test_it_plays_what_the_dialogue_env_plays(restaurant):
    seed = 1
    errors = {"slot_error_prob": 0.2, "slot_error_mode": "mixed", "intent_error_prob": 0.1}
    rewards = {"success_reward": 7.0, "failure_reward": -3.0, "turn_reward": -0.5}
    settings = {"max_turn": 12, **errors, **rewards}
    one = gymnasium.make(ENV_ID, domain=restaurant, **settings).unwrapped
    other = DialogueEnv(restaurant, **settings)
    assert other.set_seed(seed) != seed
    one.action_space.seed(seed)
    for dialogue in range(12):
        observation, info = one.reset(seed=seed if dialogue == 0 else None)
        played, over = other.reset(), False
        assert "is_success" not in info
        assert np.array_equal(observation, played["observation"].numpy())
        while not over:
            assert observation in one.observation_space
            action = int(one.action_space.sample(info["action_mask"]))
            observation, reward, over, truncated, info = one.step(action)
            played = other.step(TensorDict({"action": torch.tensor(action)}))["next"]
            assert np.array_equal(observation, played["observation"].numpy())
            assert (reward, over) == (played["reward"].item(), played["terminated"].item())
            assert (type(reward), type(over), truncated) == (float, bool, False)
            assert info.get("is_success") == (played["success"].item() if over else None)
        told = {name: played[name].item() for name in ("success", "turns", "goal_id")}
        assert {name: info[name] for name in told} == told
        assert observation in one.observation_space


def test_seeds_decide_and_without_one_dialogues_differ(restaurant):
    own = gymnasium.make(ENV_ID, domain=restaurant, seed=3)
    assert goals_of(own) == goals_of(gymnasium.make(ENV_ID, domain=restaurant), seed=3)
    unseeded = [goals_of(gymnasium.make(ENV_ID, domain=restaurant)) for _ in range(3)]
    assert not unseeded[0] == unseeded[1] == unseeded[2]


def test_a_folder_is_a_domain_too_and_goal_and_dialogue_can_be_read(restaurant_folder, restaurant):
    env = gymnasium.make(ENV_ID, domain=str(restaurant_folder), render_mode="ansi")
    goal = restaurant.goals[env.reset(seed=0)[1]["goal_id"]]
    assert env.unwrapped.domain == restaurant
    assert all(f"{slot}={value}" in env.unwrapped.goal for slot, value in goal.constraints.items())
    assert all(slot in env.unwrapped.goal for slot in goal.requests)
    assert env.render().startswith("user: request(")


def test_masks_follow_the_domain_extension():
    env = gymnasium.make(ENV_ID, schedule=ExtensionSchedule(start=1, every=1)).unwrapped
    assert env.action_masks().sum() == 19
    env.set_round(1)
    assert env.action_masks().sum() == 21
    assert np.array_equal(env.reset()[1]["action_mask"], env.action_masks())


def test_a_goal_can_be_chosen_and_all_else_stays(restaurant):
    env = gymnasium.make(ENV_ID, domain=restaurant, slot_error_prob=0.3)
    drawn = goals_of(env, seed=1)
    for goal_id in range(len(restaurant.goals)):
        _, info = env.reset(seed=1, options={"goal_id": np.int64(goal_id)})
        assert info["goal_id"] == goal_id
        assert goals_of(env, count=7) == drawn[1:]


@pytest.mark.parametrize(
    ("seed", "options", "message"),
    [
        (0, {"goal": 5}, "'goal'"),
        (0, {"goal_id": 1, "turn": 2}, "'turn'"),
        *((0, {"goal_id": goal}, f"goal_id .*{goal!r}") for goal in (-1, 10**6, 1.5, "5", True)),
        (2**70, None, "seed"),
    ],
    ids=str,
)
def test_other_options_and_seeds_are_refused(env, seed, options, message):
    with pytest.raises(ValueError, match=message):
        env.reset(seed=seed, options=options)
    with pytest.raises(ResetNeeded):
        env.step(0)


@pytest.mark.parametrize("schedule", [None, ExtensionSchedule(start=1, every=1)], ids=str)
def test_torchrls_gymenv_finds_the_mask(restaurant, schedule):
    given = {"domain": restaurant, "schedule": schedule, "max_turn": 12}
    made = GymEnv(ENV_ID, mask_in_observation=True, **given)
    env = TransformedEnv(made, ActionMask())
    check_env_specs(env)
    legal = torch.from_numpy(made.unwrapped.action_masks())
    network = BayesMLP(env.observation_spec["observation"].shape[-1], len(legal))
    for policy in (None, q_actor(network, env.action_spec_unbatched)):
        played = env.rollout(30, policy, break_when_any_done=False)
        assert played["action_mask"].dtype == torch.bool
        assert (played["action_mask"] == legal).all()
        assert not (played["action"].bool() & ~legal).any()


@pytest.mark.parametrize("action", [-1, 22, 1.5, "thanks", np.array([1, 2])])
def test_what_is_no_action_is_refused(env, action):
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action"):
        env.step(action)


def test_a_turn_after_the_end_is_refused(env, restaurant):
    env.reset()
    env.step(restaurant.action_index("thanks"))
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(0)
