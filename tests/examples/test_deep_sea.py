"""DeepSea beside a diver written in plain Python, one at a time."""

import pytest
import torch
from deep_sea_env import DeepSeaEnv
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
