"""Learner x explorer: a cell a setting, rows by learner, compared by pairs."""

from __future__ import annotations

from dataclasses import asdict

import pytest
from result_folders import sweeps
from scipy import stats

from bbq_torchrl.evaluation.designs import deviations, find_grid
from bbq_torchrl.evaluation.finished_runs import agent_name
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.runs.compose import compose

OWN = [0.70, 0.80, 0.75, 0.72, 0.78]
LESS = [0.60, 0.72, 0.64, 0.62, 0.66]
SAME = [0.71, 0.79, 0.75, 0.73, 0.77]


@pytest.fixture
def runs(add):
    return [
        add(OWN),
        add(LESS, explore="greedy"),
        add(SAME, explore="boltzmann"),
        add(OWN, agent="dqn", explore="epsilon_greedy"),
        add(LESS, agent="dqn", explore="greedy", dropout=0.0),
    ]


def test_learners_are_rows_whose_explorers_are_compared_with_the_first_by_holm(runs):
    grid = find_grid(read_groups(runs))
    assert {name: list(row) for name, row in grid.items()} == {
        "BBQN-MAP": ["thompson", "greedy", "boltzmann"],
        "DQN, agent.dropout=0.5": ["epsilon_greedy"],
        "DQN, agent.dropout=0.0": ["greedy"],
    }
    greedy, boltzmann = deviations(grid["BBQN-MAP"], "final")
    assert (greedy.other, greedy.one, boltzmann.one) == ("thompson", "greedy", "boltzmann")
    raw = [stats.ttest_rel(other, OWN).pvalue for other in (LESS, SAME)]
    assert greedy.p_value == pytest.approx(2 * raw[0])  # the smaller of two
    assert boltzmann.p_value == pytest.approx(max(raw[1], 2 * raw[0]))
    expected = [less - own for less, own in zip(LESS, OWN, strict=True)]
    assert greedy.differences == pytest.approx(expected)


def test_learners_are_compared_by_the_same_explorer(runs, report):
    lines = report("--grid").splitlines()
    crossed = [line for line in lines if line.startswith("| greedy | ")]
    # Both have the same rates here: no difference, of final and of training success.
    assert len(crossed) == 2
    for line in crossed:
        assert line.startswith("| greedy | DQN, agent.dropout=0.0 minus BBQN-MAP | +0.000 [")
    assert not any(line.startswith("| thompson |") for line in lines)  # one learner has it
    final = next(line for line in lines if line.startswith("| BBQN-MAP | greedy minus thompson |"))
    assert final.endswith("| no |")
    assert sum(line.count("not run") for line in lines) == 2 * (3 * 4 - 5)


def test_evaluation_is_compared_where_all_were_evaluated(add, report):
    add(OWN, eval_every=1)
    add(LESS, explore="greedy", eval_every=1)
    part = report("--grid").partition("## Success in evaluation while training")[2]
    difference = sum(LESS) / 5 - sum(OWN) / 5
    assert f"| BBQN-MAP | greedy minus thompson | {difference:+.3f} [" in part
    # the metrics of these runs are .1 and .2 below the final rate in the rounds before the last
    assert f"| {sum(OWN) / 5 - 0.1:.3f} [" in part
    add(SAME, explore="boltzmann")
    assert "evaluation while training" not in report("--grid").partition("Means over")[0]


def test_two_settings_of_a_cell_are_refused(runs, add, report):
    add(OWN, changes={"protocol.batch_size": 64})
    assert "got two of BBQN-MAP with explore=thompson" in report("--grid", code=2)


def test_the_recipes_of_the_grid_are_its_cells():
    found = set()
    for name, overrides in sweeps("explorers"):
        config = compose([f"+experiment={name}", *overrides])
        assert (config.protocol.rounds, config.replicas) == (100, 10)
        learner = agent_name(asdict(config) | {"explore": {}})
        found.add((learner, getattr(config.agent, "dropout", None), config.explore.name))
    explorers = ("epsilon_greedy", "greedy", "boltzmann")
    assert found == {
        *(("BBQN-MAP", None, name) for name in ("thompson", *explorers, "thompson_epsilon")),
        *(("DQN", rate, name) for rate in (0.0, 0.5) for name in explorers),
        *(("DQN-Bootstrap", None, name) for name in ("bootstrap", "greedy")),
    }
