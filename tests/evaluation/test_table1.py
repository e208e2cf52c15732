"""Table 1: the paper's numbers beside ours, declared pairs, and what is missing by name."""

from __future__ import annotations

import pytest
from scipy import stats
from tiny import rows

from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.evaluation.table1 import PAPER, comparisons, find_cells
from bbq_torchrl.options.registry import options
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.utils.statistics import estimate

GOOD = [0.70, 0.80, 0.75, 0.72, 0.78]
BAD = [0.68, 0.77, 0.74, 0.69, 0.74]
DQN = {"agent": "dqn", "explore": "epsilon_greedy"}


@pytest.fixture
def runs(add):
    """Two of the eighteen cells."""
    return [add(GOOD, eval_every=1), add(BAD, **DQN)]


@pytest.mark.parametrize(
    ("setting", "env", "rounds"),
    [("table1_full", "full", 150), ("table1_extension", "domain_ext", 200)],
)
def test_every_cell_has_a_recipe(setting, env, rounds):
    agents = {f"agents/{name.replace('-', '_').lower()}" for name in PAPER["full"]}
    assert agents <= set(options("experiment"))
    config = compose([f"+experiment=[agents/bbqn_map,{setting}]"])
    assert (config.env.name, config.protocol.rounds, config.replicas) == (env, rounds, 5)
    assert (config.agent.std_init, config.protocol.batch_size) == (0.09, 128)


def test_the_papers_number_stands_beside_ours_and_what_is_missing_is_named(runs, report):
    text = report("--table1")
    assert text.startswith("# Table 1: 2 of 18 cells\n\nNot run: BBQN-MC with env=full; ")
    missing = text.splitlines()[2]
    assert missing.count(" with env=") == 16
    assert "DQN-Boltzmann with env=full" in missing
    assert "DQN with env=full" not in missing
    (row,) = (line for line in text.splitlines() if line.startswith("| BBQN-MAP | 5 |"))
    assert f"| 5 | 3 | {estimate(GOOD)} |" in row
    assert "| 0.5031 | 10.00 | 10.71 |" in row
    # A cell each, and a comparison each by three quantities.
    full, extension = text.split("## env=domain_ext")
    assert full.count("| not run |") == 7 + 3 * 7
    assert extension.count("| not run |") == 9 + 3 * 8


def test_p_values_are_adjusted_for_every_comparison_that_was_declared(runs):
    expected = 8 * stats.ttest_rel(GOOD, BAD).pvalue
    assert 0.01 < expected < 1
    cells = find_cells(read_groups(runs), "full")
    found = {item.other: item for item in comparisons(cells, "full", "final")}
    assert len(found) == 8
    assert found["DQN"].p_value == pytest.approx(expected)
    assert found["DQN"].cells()[0].value == pytest.approx(0.026)
    assert (found["BBQN-MC"].p_value, found["BBQN-MC"].differences) == (1, None)


def test_agents_that_share_fewer_than_two_replicas_are_not_paired(add, report):
    for seed, rate in enumerate(GOOD):
        add([rate], seed=seed)
    add(BAD[:1], seed=0, **DQN)
    full = report("--table1").partition("## env=domain_ext")[0]
    assert "| BBQN-MAP minus DQN" + 3 * " | – | – | not paired" in full
    assert "| BBQN-MAP minus BBQN-MC" + 3 * " | – | – | not run" in full


def test_two_settings_of_a_cell_are_refused(runs, add, report):
    add(GOOD, name="other", prior_std=0.2)
    error = report("--table1", code=2)
    assert "got two of BBQN-MAP with env=full: " in error
    assert "other" in error


def test_every_replica_is_a_row(runs, add, report, tmp_path):
    add(GOOD, noisy=True, **DQN)  # no agent of the table
    report("--table1", "--out", str(tmp_path / "report"))
    replicas = rows(tmp_path / "report" / "replicas.csv")
    assert [row["agent"] for row in replicas] == ["BBQN-MAP"] * 5 + ["DQN"] * 5
    assert [row["replica"] for row in replicas] == 2 * list("01234")
    assert [float(row["success_rate"]) for row in replicas] == GOOD + BAD
    assert replicas[0] == {
        **{"corpus": "movie", "env": "full", "agent": "BBQN-MAP", "replica": "0", "seed": "0"},
        **{"rounds": "3", "updates": "", "rounds_to_60": ""},
        **{"success_rate": "0.7", "reward": "10.0", "turns": "8.0", "cumulative_success": "0.35"},
    }
