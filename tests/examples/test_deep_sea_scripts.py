"""DeepSea's scripts as a person types them, and what they make of results."""

from __future__ import annotations

import re
import sys

import forked
import pytest
import sweep
import torch
from deep_sea_agents import Settings
from deep_sea_results import AGENT_NAMES, Line, append, read
from deep_sea_training import DiveMemory, train
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
