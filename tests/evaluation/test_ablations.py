"""Ablations: a reference, and runs that each change one key of it."""

from __future__ import annotations

from dataclasses import asdict

import pytest
from result_folders import sweeps
from scipy import stats

from bbq_torchrl.evaluation.designs import find_ablations
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.runs.compose import compose

OWN = [0.70, 0.80, 0.75, 0.72, 0.78]
LESS = [0.66, 0.78, 0.70, 0.71, 0.72]
SAME = [0.71, 0.79, 0.75, 0.73, 0.77]


@pytest.fixture
def runs(add):
    return [
        add(LESS, changes={"agent.prior_std": 0.3}),
        add(OWN),
        add(SAME, changes={"agent.prior_std": 0.01}),
        add(LESS, changes={"spike.dialogues": 20}),
        add(SAME, changes={"spike.drop_above": 0.5}),
        add(SAME, explore="greedy", changes={"explore.per": None}),
        add(SAME, changes={"agent.hidden": [64]}),
        add(SAME, changes={"explore.per": "round", "explore.shared": True}),
    ]


def cells(text, start):
    (line,) = (line for line in text.splitlines() if line.startswith(start))
    return [cell.strip() for cell in line.strip("|").split("|")]


def values(ablations):
    return {key: list(row) for key, row in ablations.keys.items()}


def test_the_reference_is_what_all_others_differ_from_in_one_group(runs):
    found = find_ablations(read_groups(runs))
    assert found.reference.final == OWN
    assert values(found) == {
        "agent.prior_std": ["0.01", "0.1", "0.3"],
        "spike.dialogues": ["20", "100"],
        "spike.drop_above": ["null", "0.5"],
        "explore": ["thompson", "greedy"],
        "agent.hidden": ["null", "[64]"],
        "explore.per, explore.shared": ["step, null", "round, true"],
    }
    assert all(found.reference in row.values() for row in found.keys.values())


def test_settings_of_one_option_are_values_of_their_own(add, report):
    folders = [add(OWN)]
    for eps in (0.1, 0.2):
        keys = {"explore.eps_init": eps, "explore.eps_end": 0.01}
        folders.append(add(LESS, explore="epsilon_greedy", changes=keys))
    folders.append(add(SAME, explore="greedy"))
    epsilons = [f"epsilon_greedy, explore.eps_init={eps}" for eps in (0.1, 0.2)]
    found = find_ablations(read_groups(folders))
    assert values(found) == {"explore": ["thompson", *epsilons, "greedy"]}
    assert cells(report("--ablations"), "| thompson (reference) |")[1] == "5"


def test_values_are_compared_with_the_reference_by_pairs(runs, report):
    text = report("--ablations")
    p_value = stats.ttest_rel(LESS, OWN).pvalue
    final = cells(text, "| 0.3 |")
    assert final[3].startswith(f"{sum(LESS) / 5 - sum(OWN) / 5:+.3f} [")
    assert final[4] == f"{2 * p_value:.3f}"  # by Holm the smaller of two
    assert cells(text, "| 0.1 (reference) |")[3:5] == ["–", "–"]
    # Other spiked dialogues, but seeds are pairs all the same.
    assert cells(text, "| 20 |")[3:5] == [final[3], f"{p_value:.3f}"]


def test_runs_of_other_lengths_are_compared_but_for_their_curves(add, report):
    for rounds in (4, 6):  # the first is the reference
        add(OWN, rounds=rounds, eval_every=2)
    assert cells(report("--ablations"), "| 6 |")[3].startswith("+0.000 [")


@pytest.mark.parametrize(("order", "reference"), [("102", "0.1"), ("012", "0.3")])
def test_of_one_key_alone_the_reference_is_the_first_given(runs, report, order, reference):
    text = report("--ablations", runs=[runs[int(number)] for number in order])
    assert cells(text, f"| {reference} (reference) |")[1] == "5"


def test_what_is_no_ablation_is_refused(add, report):
    add(OWN)
    assert "runs of two settings, got 1" in report("--ablations", code=2)
    add(SAME, changes={"agent.prior_std": 0.3, "spike.dialogues": 20})
    assert "agent.prior_std, spike.dialogues" in report("--ablations", code=2)


def test_every_recipe_changes_one_key_of_the_reference():
    reference = asdict(compose(["+experiment=ablations/reference"]))
    jobs = [(name, overrides) for name, overrides in sweeps("ablations") if overrides]
    assert len({name for name, _ in jobs}) == 8
    for name, (override,) in jobs:
        group, key = override.partition("=")[0].split(".")
        config = asdict(compose([f"+experiment={name}", override]))
        assert config[group][key] != reference[group][key]
        assert config | {group: config[group] | {key: reference[group][key]}} == reference
