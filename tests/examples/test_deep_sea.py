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


@pytest.mark.parametrize("size", [1, 2, 5])
def test_divers_move_earn_and_begin_again_by_the_rules(size):
    """Those of Osband et al., for one diver after the other; each replica has its own mapping."""
    env = DeepSeaEnv(size, (3, 2), mapping_seed=range(3))
    check_env_specs(env)
    td, places = env.reset(), [(0, 0, False)] * 6
    for _ in range(30 * size):
        # Mostly right, so that divers come to every column; those at the bottom stay there.
        goes_right = torch.rand(3, 2) < 0.8
        cell = td["observation"].argmax(-1, keepdim=True)
        right = env.right_action.flatten(-2).gather(-1, cell)[..., 0]
        td = env.step(td.set("action", torch.where(goes_right, right, 1 - right)))["next"]
        for n, (is_right, (row, column, found)) in enumerate(
            zip(goes_right.flatten().tolist(), places, strict=True)
        ):
            earned = 0.0
            if row < size:
                wins = is_right and column == size - 1
                earned = wins - is_right * 0.01 / size
                column = min(max(column + (1 if is_right else -1), 0), size - 1)
                places[n] = (row + 1, column, found or wins)
            assert td["reward"].flatten()[n].item() == pytest.approx(earned)
        which = torch.rand(3, 2, 1) < 0.3
        td = env.reset(td.exclude("reward").set("_reset", which))
        for n, begins in enumerate(which.flatten().tolist()):
            places[n] = (0, 0, False) if begins else places[n]
            row, column, found = places[n]
            seen = td["observation"].flatten(0, 1)[n].nonzero().flatten().tolist()
            assert seen == ([row * size + column] if row < size else [])
            assert td["terminated"].flatten()[n] == td["done"].flatten()[n] == (row == size)
            assert td["treasure"].flatten()[n] == found


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
