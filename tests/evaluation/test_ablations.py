"""Ablations: a reference, and runs that each change one key of it."""

from __future__ import annotations

from dataclasses import asdict

import pytest
from result_folders import make_run, sweeps
from scipy import stats

from bbq_torchrl.cli.store import compose
from bbq_torchrl.evaluation.ablations import find_ablations
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.evaluation.report import main

OWN = [0.70, 0.80, 0.75, 0.72, 0.78]
LESS = [0.66, 0.78, 0.70, 0.71, 0.72]
SAME = [0.71, 0.79, 0.75, 0.73, 0.77]


@pytest.fixture
def runs(tmp_path):
    make_run(tmp_path / "0", LESS, changes={"agent.prior_std": 0.3})
    make_run(tmp_path / "1", OWN)
    make_run(tmp_path / "2", SAME, changes={"agent.prior_std": 0.01})
    make_run(tmp_path / "3", LESS, changes={"spike.dialogues": 20})
    make_run(tmp_path / "4", SAME, changes={"spike.drop_above": 0.5})
    make_run(tmp_path / "5", SAME, explore="greedy", changes={"explore.per": None})
    make_run(tmp_path / "6", SAME, changes={"agent.hidden": [64]})
    make_run(tmp_path / "7", SAME, changes={"explore.per": "round", "explore.shared": True})
    return tmp_path


def cells(text, start):
    (line,) = (line for line in text.splitlines() if line.startswith(start))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_reference_is_what_all_others_differ_from_in_one_group(runs):
    reference, keys = find_ablations(read_groups(sorted(runs.iterdir())))
    assert reference.final == OWN
    assert {key: list(row) for key, row in keys.items()} == {
        "agent.prior_std": ["0.01", "0.1", "0.3"],
        "spike.dialogues": ["20", "100"],
        "spike.drop_above": ["null", "0.5"],
        "explore": ["thompson", "greedy"],
        "agent.hidden": ["null", "[64]"],
        "explore.per, explore.shared": ["step, null", "round, true"],
    }
    assert all(reference in row.values() for row in keys.values())


def test_settings_of_one_option_are_values_of_their_own(tmp_path, capsys):
    make_run(tmp_path / "0", OWN)
    for eps in (0.1, 0.2):
        keys = {"explore.eps_init": eps, "explore.eps_end": 0.01}
        make_run(tmp_path / str(eps), LESS, explore="epsilon_greedy", changes=keys)
    make_run(tmp_path / "greedy", SAME, explore="greedy")
    folders = [tmp_path / name for name in ("0", "0.1", "0.2", "greedy")]
    _, keys = find_ablations(read_groups(folders))
    assert {key: list(row) for key, row in keys.items()} == {
        "explore": [
            "thompson",
            "epsilon_greedy, explore.eps_init=0.1",
            "epsilon_greedy, explore.eps_init=0.2",
            "greedy",
        ]
    }
    assert main([*map(str, folders), "--ablations"]) == 0
    assert cells(capsys.readouterr().out, "| thompson (reference) |")[1] == "5"


def test_values_are_compared_with_the_reference_by_pairs(runs, capsys):
    assert main([str(runs), "--ablations"]) == 0
    text = capsys.readouterr().out
    raw = [stats.ttest_rel(other, OWN).pvalue for other in (LESS, SAME)]
    final = cells(text, "| 0.3 |")
    assert final[3].startswith(f"{sum(LESS) / 5 - sum(OWN) / 5:+.3f} [")
    assert final[4] == f"{2 * raw[0]:.3f}"  # by Holm the smaller of two
    assert cells(text, "| 0.1 (reference) |")[3:5] == ["–", "–"]
    # Other spiked dialogues, but seeds are pairs all the same.
    assert cells(text, "| 20 |")[3:5] == [final[3], f"{raw[0]:.3f}"]


def test_runs_of_other_lengths_are_compared_but_for_their_curves(tmp_path, capsys):
    for rounds in (6, 4):
        make_run(tmp_path / str(rounds), OWN, rounds=rounds, eval_every=2)
    assert main([str(tmp_path), "--ablations"]) == 0
    assert cells(capsys.readouterr().out, "| 6 |")[3].startswith("+0.000 [")


def test_of_one_key_alone_the_reference_is_the_first_given(runs, capsys):
    assert main([str(runs / name) for name in "102"] + ["--ablations"]) == 0
    assert cells(capsys.readouterr().out, "| 0.1 (reference) |")[1] == "5"
    assert main([str(runs / name) for name in "012"] + ["--ablations"]) == 0
    assert cells(capsys.readouterr().out, "| 0.3 (reference) |")[1] == "5"


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"agent.prior_std": 0.3, "spike.dialogues": 20}, "agent.prior_std, spike.dialogues"),
        (None, "two"),
    ],
)
def test_what_is_no_ablation_is_refused(tmp_path, capsys, changes, names):
    make_run(tmp_path / "0", OWN)
    if changes:
        make_run(tmp_path / "1", SAME, changes=changes)
    assert main([str(tmp_path), "--ablations"]) == 2
    assert names in capsys.readouterr().err


def test_every_recipe_changes_one_key_of_the_reference():
    reference = asdict(compose(["+experiment=ablations/reference"]))
    jobs = [(name, overrides) for name, overrides in sweeps("ablations") if overrides]
    assert len({name for name, _ in jobs}) == 8
    for name, (override,) in jobs:
        group, key = override.partition("=")[0].split(".")
        config = asdict(compose([f"+experiment={name}", override]))
        assert config[group][key] != reference[group][key]
        assert config | {group: config[group] | {key: reference[group][key]}} == reference
