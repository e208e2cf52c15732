"""DeepSea's scripts as a person types them, and what they make of results."""

from __future__ import annotations

import re
import sys

import figure
import forked
import pytest
import sweep
import torch
from deep_sea_agents import Settings, default_settings, make_agent
from deep_sea_env import DeepSeaEnv
from deep_sea_results import AGENT_NAMES, Line, append, read
from deep_sea_training import DiveMemory, reaches_treasure, train
from extended import EXAMPLES
from tensordict import TensorDict

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


def test_figure_is_drawn_from_what_there_is(tmp_path):
    solved = [Line("bbqn_mean", 4, seed, 30 + seed, 90, 9) for seed in range(3)]
    unsolved = [Line("bootstrap", 6, seed, None, 300, 0) for seed in range(3)]
    figure.draw([*solved, *unsolved], tmp_path / "deep_sea.png")
    assert (tmp_path / "deep_sea.png").stat().st_size > 10_000


@pytest.mark.parametrize("target_noise", ["mean", "independent", "shared"])
def test_names_of_bbqn_tell_target_and_start(target_noise):
    name = f"bbqn_{target_noise}"
    ours, papers = (make_agent(n, 3, 2, default_settings(n)) for n in (name, f"{name}_zero"))
    assert ours.loss.target_noise == papers.loss.target_noise == target_noise
    observation = torch.eye(9).expand(2, 9, 9)
    values = [
        agent.greedy(TensorDict({"observation": observation}, [2, 9]))["action_value"]
        for agent in (ours, papers)
    ]
    assert bool((values[0] != 0).all())
    assert bool((values[1] == 0).all())


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


def test_unknown_agent_is_refused():
    with pytest.raises(ValueError, match=r"agent must be one of \['epsilon_greedy', .*got 'dqn'"):
        make_agent("dqn", 3, 1, SMALL)


class Follows:
    """Acts by a table of actions for each replica, [replicas, N·N]."""

    def __init__(self, actions):
        self.actions = actions

    def greedy(self, td):
        return td.set("action", self.actions.gather(-1, td["observation"].argmax(-1)))


def test_one_look_at_the_diagonal_tells_who_reaches_the_treasure():
    env = DeepSeaEnv(5, (64, 1), mapping_seed=range(64))
    generator = torch.Generator().manual_seed(0)
    best = env.right_action.flatten(-2)[:, 0]
    wrong = torch.rand(best.shape, generator=generator) < 0.1
    policy = Follows(torch.where(wrong, 1 - best, best))
    told = reaches_treasure(policy, env)
    dive = env.rollout(5, policy.greedy)
    assert told.tolist() == dive["next", "treasure"][:, 0, -1, 0].tolist()
    assert 5 < int(told.sum()) < 60


def rows(first, steps):
    values = torch.arange(first, first + steps, dtype=torch.float32)
    reward = torch.stack([values, -values])[..., None]
    one_hot = torch.eye(9)[torch.arange(first, first + steps) % 9].expand(2, steps, 9)
    return TensorDict(
        {"observation": one_hot, "next": {"observation": one_hot.flip(-1), "reward": reward}},
        [2, steps],
    )


def test_memory_keeps_the_newest_and_gives_each_replica_its_own():
    memory = DiveMemory(10)
    for first in range(0, 28, 4):
        memory.extend(rows(first, 4))
    assert len(memory) == 10
    sample = memory.sample(2000)
    reward = sample["next", "reward"].squeeze(-1)
    # Each of 10 rows is missing among 2000 with probability .9^2000.
    assert reward[0].unique().tolist() == list(range(18, 28))
    assert (-reward[1]).unique().tolist() == list(range(18, 28))
    assert not torch.equal(reward[0], -reward[1])
    assert sample["observation"].dtype == torch.float32
    assert torch.equal(sample["observation"][0].argmax(-1), reward[0].long() % 9)
    assert torch.equal(sample["next", "observation"], sample["observation"].flip(-1))
