"""Replicas that trained on the same dialogues are compared by pairs, and no others."""

from __future__ import annotations

import pytest
import torch
from scipy import stats

from bbq_torchrl.evaluation.comparison import pair_parts
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.evaluation.pairs import NO_PARTNER, Comparison, pair
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer

GOOD = [0.70, 0.80, 0.75, 0.72, 0.78]
BAD = [0.50, 0.40, 0.60, 0.55, 0.45]
DQN = {"agent": "dqn", "explore": "epsilon_greedy"}
EXTENSION = {"env.name": "domain_ext", "env.start": 40}


def compared(*folders):
    """The one pairing of the two groups that the folders make."""
    return pair(*read_groups(folders))


@pytest.mark.parametrize("other", ["agent=dqn", "agent=bbqn agent.prior_std=.2"])
def test_the_same_replica_of_two_agents_sees_the_same_dialogues(tmp_path, other):
    small = ["replicas=2", "protocol.dialogues=6", "spike.dialogues=6", "agent.hidden=[8]"]
    spiked, goals = [], []
    for overrides in (["agent=bbqn"], other.split()):
        trainer, _ = build_trainer(compose([*overrides, *small]), tmp_path / overrides[-1])
        trainer.begin()
        spiked.append(
            [buffer[:].select("observation", "action") for buffer in trainer.replay.buffers]
        )
        trainer._collect(0)
        goals.append(trainer.env.dialogues["goal_id"])
    assert all((mine == theirs).all() for mine, theirs in zip(*spiked, strict=True))
    assert torch.equal(*goals)


def test_replicas_of_a_seed_are_paired_by_number_whatever_the_folders_order(add):
    folders = [
        add([0.5, 0.9], seed=1),
        add([0.1, 0.2], seed=0, **DQN),
        add([0.3, 0.6], seed=0),
        add([0.4, 0.7], seed=1, **DQN),
    ]
    found = compared(*folders)
    assert (found.label, found.pairs, found.remark) == ("BBQN-MAP minus DQN", 4, "")
    expected = [0.3 - 0.1, 0.6 - 0.2, 0.5 - 0.4, 0.9 - 0.7]
    assert found.differences["final"] == expected
    assert found.differences["cumulative"] == pytest.approx([value / 2 for value in expected])
    again = compared(folders[3], *folders[:3])
    assert again.label == "DQN minus BBQN-MAP"
    assert again.differences["final"] == [-value for value in expected]


@pytest.mark.parametrize(
    ("settings", "remark"),
    [
        ({"changes": EXTENSION}, "env.name differs (full, domain_ext)"),
        ({"changes": {"env.max_turn": 20}}, "env.max_turn differs (40, 20)"),
        ({"changes": {"domain.name": "miulab"}}, "domain.name differs (movie, miulab)"),
        ({"changes": {"spike.dialogues": 50}}, "spike.dialogues differs (100, 50)"),
        ({"rounds": 4}, "protocol.rounds differs (3, 4)"),
        # the same dialogues, but other random numbers
        ({"seed": 1}, NO_PARTNER),
        ({"changes": {"replicas": 8}}, NO_PARTNER),
        ({"changes": {"device": "cuda:0"}}, NO_PARTNER),
    ],
)
def test_other_dialogues_and_other_random_numbers_are_not_paired(add, settings, remark):
    found = compared(add(GOOD), add(BAD, **DQN, **settings))
    assert (found.pairs, found.differences, found.remark) == (0, {}, remark)


def test_a_script_that_a_run_found_by_itself_is_paired_with_the_same_one_given(add):
    given = {"changes": {"spike.policy": "rule"}}
    found = {"changes": {"spike.policy": None}}
    other = {"changes": {"spike.policy": "repair"}}
    by_itself = add(BAD, **DQN, **found)
    assert compared(add(GOOD, **given), by_itself).remark == ""
    assert compared(add(GOOD, **other), by_itself).remark == "spike.policy differs (repair, rule)"
    best = add(BAD, **DQN, changes={"spike.name": "best", "spike.policy": None})
    assert compared(add(GOOD, **other), best).remark == ""
    assert compared(best, by_itself).remark == "spike.policy differs (repair, rule)"


@pytest.mark.parametrize(
    ("key", "value", "typed"),
    [("spike.protect", False, "false"), ("protocol.batch_size", 128, "128")],
)
def test_learning_in_another_way_from_the_same_dialogues_is_paired_and_named(
    add, key, value, typed
):
    found = compared(add(GOOD), add(BAD, changes={key: value}, **DQN))
    assert found.pairs == 5
    assert found.label.endswith(f"DQN, {key}={typed}")
    assert f"BBQN-MAP, {key}=" in found.label


def test_replicas_with_values_of_their_own_are_not_paired_with_each_other(add):
    values = [{"agent.prior_std": std} for std in (0.05, 0.2)]
    run = add([0.5, 0.6], values=values, prior_std=[0.05, 0.2])
    small, large, dqn = read_groups([run, add([0.25, 0.5], **DQN)])
    assert pair(small, large).remark == NO_PARTNER
    assert pair(small, dqn).differences["final"] == [0.25]
    found = pair(large, dqn)
    assert found.differences["final"] == pytest.approx([0.1])
    assert found.remark == "1 of 2 replicas of DQN"


def test_seeds_without_a_partner_are_left_out_and_named(add):
    found = compared(add(GOOD, seed=0), add(GOOD, seed=1), add(BAD, seed=1, **DQN))
    assert (found.pairs, found.remark) == (5, "5 of 10 replicas of BBQN-MAP")
    _, remark = pair_parts([found])
    assert remark == "BBQN-MAP minus DQN: without 5 of 10 replicas of BBQN-MAP."


def test_pairs_are_rows_and_what_is_not_paired_is_named_once(add):
    one, dqn, longer = read_groups([add(GOOD), add(BAD, **DQN), add(BAD, rounds=4, **DQN)])
    table, remark = pair_parts([pair(one, dqn), pair(one, longer), pair(dqn, longer)])
    (row,) = table.rows
    assert (row["by pairs"], row["pairs"]) == (f"{one.label} minus {dqn.label}", 5)
    assert (row["final success"].low, row["final success"].high) == pytest.approx(
        stats.ttest_rel(GOOD, BAD).confidence_interval()
    )
    assert f"| 5 | {row['final success']:+.3f} | +0.125 [" in str(table)
    assert remark == (
        "Not compared by pairs, since protocol.rounds differs (3, 4): "
        f"{one.label} and {longer.label}; {dqn.label} and {longer.label}."
    )


@pytest.mark.parametrize(
    ("differences", "p_value", "expected"),
    [([0.1, 0.2], 0.01, "yes"), ([-0.1, -0.2], 0.01, "no"), ([0.1, 0.2], 0.2, "not significant")],
)
def test_a_claim_is_judged_by_sign_and_p_value(differences, p_value, expected):
    assert Comparison("one", "other", differences, p_value).cells()[2] == expected
