"""One dialogue as a Gymnasium environment: its checker, and the same dialogues as DialogueEnv's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.error import ResetNeeded  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

from bbq_torchrl.envs.gymnasium import ENV_ID  # noqa: E402

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.domains import Domain


def test_gymnasiums_checker_has_nothing_to_say():
    check_env(gymnasium.make(ENV_ID).unwrapped)  # a warning would be an error


def test_a_wrapped_environment_plays_to_the_end():
    env = gymnasium.make(ENV_ID)
    _, info = env.reset(seed=3)
    env.action_space.seed(3)
    over = False
    while not over:
        action = env.action_space.sample(info["action_mask"])
        _, reward, over, truncated, info = env.step(action)
        assert type(reward) is float
        assert type(over) is bool
        assert truncated is False
    assert type(info["success"]) is bool
    with pytest.raises(ResetNeeded, match="no dialogue under way"):
        env.unwrapped.step(0)


@pytest.mark.parametrize("seed", range(3))
def test_it_plays_what_the_dialogue_env_plays(restaurant: Domain, seed: int):
    settings = {
        "slot_error_prob": 0.2,
        "slot_error_mode": "mixed",
        "intent_error_prob": 0.1,
        "max_turn": 12,
        "success_reward": 7.0,
        "failure_reward": -3.0,
        "turn_reward": -0.5,
    }
    one = gymnasium.make(ENV_ID, domain=restaurant, **settings).unwrapped
    other = DialogueEnv(restaurant, batch_size=(), **settings)
    other.set_seed(seed)
    choose = np.random.default_rng(seed)
    for dialogue in range(12):
        observation, info = one.reset(seed=seed if dialogue == 0 else None)
        played = other.reset()
        assert observation in one.observation_space
        assert np.array_equal(observation, played["observation"].numpy())
        over = False
        while not over:
            action = int(choose.choice(np.flatnonzero(one.action_masks())))
            observation, reward, over, _, info = one.step(action)
            played = other.step(TensorDict({"action": torch.tensor(action)}))["next"]
            assert observation in one.observation_space
            assert np.array_equal(observation, played["observation"].numpy())
            assert reward == played["reward"].item()
            assert over == played["terminated"].item()
        told = {name: played[name].item() for name in ("success", "turns", "goal_id")}
        assert {name: info[name] for name in told} == told


def test_a_seed_of_the_environment_is_that_of_its_first_dialogues(restaurant: Domain):
    own = gymnasium.make(ENV_ID, domain=restaurant, seed=3)
    other = gymnasium.make(ENV_ID, domain=restaurant)
    goals = [[own.reset()[1]["goal_id"] for _ in range(8)]]
    goals.append([other.reset(seed=3 if n == 0 else None)[1]["goal_id"] for n in range(8)])
    assert goals[0] == goals[1]


def test_the_goal_is_in_info(movie: Domain):
    env = gymnasium.make(ENV_ID).unwrapped
    _, info = env.reset(seed=0)
    goal = movie.goals[info["goal_id"]]
    assert all(f"{slot}={value}" in info["goal"] for slot, value in goal.constraints.items())
    assert all(slot in info["goal"] for slot in goal.requests)


def test_masks_follow_the_domain_extension(movie: Domain):
    env = gymnasium.make(ENV_ID, schedule=ExtensionSchedule(start=1, every=1)).unwrapped
    env.reset(seed=0)
    assert env.action_masks().sum() == 19
    env.set_round(1)
    assert env.action_masks().sum() > 19
    assert np.array_equal(env.reset()[1]["action_mask"], env.action_masks())


def test_unseeded_environments_play_different_dialogues(restaurant: Domain):
    goals = {
        tuple(env.reset()[1]["goal_id"] for _ in range(8))
        for env in (gymnasium.make(ENV_ID, domain=restaurant) for _ in range(3))
    }
    assert len(goals) > 1


def test_a_folder_is_a_domain_too(restaurant_folder: Path, restaurant: Domain):
    env = gymnasium.make(ENV_ID, domain=str(restaurant_folder), render_mode="ansi")
    env.reset(seed=0)
    assert env.unwrapped.domain.name == restaurant.name
    assert env.render().startswith("user: request(")
    assert env.action_space.n == len(restaurant.actions)


@pytest.mark.parametrize("action", [-1, 39, 1.5, "thanks", np.array([1, 2])])
def test_what_is_no_action_is_refused(action: object):
    env = gymnasium.make(ENV_ID).unwrapped
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action must be an integer from 0 to 38, got"):
        env.step(action)


def test_a_seed_that_is_too_large_is_refused():
    with pytest.raises(ValueError, match="seed must be an integer from 0 to 2\\*\\*63 - 1, got"):
        gymnasium.make(ENV_ID).unwrapped.reset(seed=2**70)
