"""DeepSea's scripts as a person types them, and what they make of results."""

import re
import sys

import forked
import pytest
import sweep
from deep_sea_agents import Settings
from deep_sea_results import AGENT_NAMES, Line, append, read
from deep_sea_training import train
from extended import EXAMPLES

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
