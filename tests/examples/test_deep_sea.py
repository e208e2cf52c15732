"""DeepSea beside a diver written in plain Python, and its scripts as a person types them."""

import re
import sys

import forked
import pytest
import sweep
import torch
from deep_sea_agents import Settings
from deep_sea_env import DeepSeaEnv
from deep_sea_results import AGENT_NAMES, Line, append, read
from deep_sea_training import train
from extended import EXAMPLES
from torchrl.envs import check_env_specs


class Diver:
    """The rules as Osband et al. state them, without a tensor."""

    def __init__(self, size, right_action):
        self.size, self.right_action = size, right_action
        self.reset()

    def reset(self):
        self.row, self.column, self.treasure = 0, 0, False

    def step(self, action):
        """Moves by one row; returns the reward. A diver at the bottom stays where it is."""
        if self.row == self.size:
            return 0.0
        reward = 0.0
        if action == self.right_action[self.row][self.column]:
            reward -= 0.01 / self.size
            if self.column == self.size - 1:
                reward += 1.0
                self.treasure = True
            else:
                self.column += 1
        elif self.column > 0:
            self.column -= 1
        self.row += 1
        return reward

    def observation(self):
        seen = [0.0] * self.size**2
        if self.row < self.size:
            seen[self.row * self.size + self.column] = 1.0
        return seen


def divers_of(env):
    mapping = env.right_action.reshape(-1, env.size, env.size).tolist()
    return [Diver(env.size, right_action) for right_action in mapping]


def assert_agree(td, divers):
    """The entries of a TensorDict are what the divers see."""
    assert td["observation"].reshape(len(divers), -1).tolist() == [d.observation() for d in divers]
    is_done = [d.row == d.size for d in divers]
    assert td["done"].flatten().tolist() == td["terminated"].flatten().tolist() == is_done
    assert not td["truncated"].any()
    assert td["treasure"].flatten().tolist() == [d.treasure for d in divers]


@pytest.mark.parametrize("batch_size", [(), (4,), (3, 1), (3, 2)], ids=str)
@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_divers_move_earn_and_begin_again_as_plain_ones(size, batch_size):
    seeds = range(batch_size[0]) if batch_size else 3
    env = DeepSeaEnv(size, batch_size, mapping_seed=seeds)
    check_env_specs(env)
    divers = divers_of(env)
    generator = torch.Generator().manual_seed(size)
    td = env.reset()
    for _ in range(30 * size):
        # Mostly right, so that divers come to every column; those at the bottom stay there.
        chance = torch.rand(batch_size, generator=generator)
        cell = td["observation"].argmax(-1, keepdim=True)
        right = env.right_action.flatten(-2).gather(-1, cell)[..., 0]
        action = torch.where(chance < 0.8, right, 1 - right)
        td = env.step(td.set("action", action))["next"]
        earned = [d.step(a) for d, a in zip(divers, action.flatten().tolist(), strict=True)]
        torch.testing.assert_close(td["reward"].flatten(), torch.tensor(earned))
        assert_agree(td, divers)
        which = td["done"] & (torch.rand(*batch_size, 1, generator=generator) < 0.5)
        which |= torch.rand(*batch_size, 1, generator=generator) < 0.1
        td = env.reset(td.exclude("reward").set("_reset", which))
        for diver, begins in zip(divers, which.flatten().tolist(), strict=True):
            if begins:
                diver.reset()
        assert_agree(td, divers)


EXAMPLE = EXAMPLES / "deep_sea"
SMALL = Settings(hidden=(8,), heads=3, batch_size=4, capacity=20, updates_per_step=0.5)


def test_driver_says_how_each_seed_did(tmp_path):
    arguments = ["--agent", "epsilon_greedy", "--size", "2", "--episodes", "6", "--seed", "3"]
    out, _ = forked.run_script(EXAMPLE / "train.py", *arguments, cwd=tmp_path)
    pattern = r"seed (\d+): (?:not solved|solved after \d+ episodes); treasure in \d of \d"
    assert re.findall(pattern, out) == ["3", "4", "5", "6", "7"]


def test_sweep_goes_on_where_it_was_stopped(tmp_path, monkeypatch, capsys):
    file = tmp_path / "deep_sea.csv"
    append([Line("bootstrap", 2, seed, None, 9, 0) for seed in range(2)], file)
    arguments = ["--agents", "bootstrap", "bbqn_shared", "--sizes", "2"]
    arguments += ["--seeds", "2", "--episodes", "3", "--file", str(file)]
    monkeypatch.setattr(sys, "argv", ["sweep.py", *arguments])
    sweep.main()
    assert [(line.agent, line.seed, line.episodes) for line in read(file)] == [
        ("bootstrap", 0, 9),
        ("bootstrap", 1, 9),
        ("bbqn_shared", 0, 3),
        ("bbqn_shared", 1, 3),
    ]
    assert capsys.readouterr().out.startswith("bbqn_shared, N = 2: episodes to solve [")


@pytest.mark.parametrize("name", AGENT_NAMES)
def test_every_agent_trains_replicas_side_by_side(name):
    results = train(name, 3, replicas=2, episodes=8, seed=5, settings=SMALL)
    assert [result.seed for result in results] == [5, 6]
    for result in results:
        assert 0 <= result.treasures <= result.episodes <= 8
        assert result.episodes_to_solve is None or 1 <= result.episodes_to_solve <= 8


def test_a_gaussian_process_with_drawn_targets_dives_deep():
    """Random dives find the treasure of N = 6 once in 64 times, so not in a tenth of 100."""
    for line in train("gp_draw", 6, replicas=3, episodes=100, seed=40):
        assert line.episodes_to_solve is not None
