"""Replicas of one seed, which trained on the same dialogues, are compared by pairs."""

import pytest
import torch

from bbq_torchrl.evaluation.groups import adjusted, pair, read_groups
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer

GOOD = [0.70, 0.80, 0.75, 0.72, 0.78]
BAD = [0.50, 0.40, 0.60, 0.55, 0.45]
DQN = {"agent": "dqn"}


def compared(*folders):
    """The one pairing of the two groups that the folders make."""
    return pair(*read_groups(folders))


def test_the_same_replica_of_two_agents_sees_the_same_dialogues(tmp_path):
    small = ["replicas=2", "protocol.dialogues=6", "spike.dialogues=6", "agent.hidden=[8]"]
    spiked, goals = [], []
    for overrides in (["agent=bbqn"], ["agent=dqn"]):
        trainer, _ = build_trainer(compose([*overrides, *small]), tmp_path / overrides[-1])
        trainer.progress = False
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
    assert (found.pairs, found.different) == (4, [])
    expected = [0.3 - 0.1, 0.6 - 0.2, 0.5 - 0.4, 0.9 - 0.7]
    assert found.differences["final"] == expected
    assert found.differences["cumulative"] == pytest.approx([value / 2 for value in expected])
    again = compared(folders[3], *folders[:3])
    assert again.differences["final"] == [-value for value in expected]


@pytest.mark.parametrize(
    ("settings", "different"),
    [
        ({"changes": {"env.name": "domain_ext", "env.start": 40}}, ["env.name (full, domain_ext)"]),
        ({"changes": {"spike.dialogues": 50}}, ["spike.dialogues (100, 50)"]),
        ({"rounds": 4}, ["protocol.rounds (3, 4)"]),
        # the same dialogues, learned from in another way
        ({"changes": {"spike.protect": False}}, []),
        ({"changes": {"protocol.batch_size": 128}}, []),
    ],
)
def test_keys_that_change_the_dialogues_are_named(add, settings, different):
    found = compared(add(GOOD), add(BAD, **DQN, **settings))
    assert (found.pairs, found.different) == (5, different)


@pytest.mark.parametrize(
    "settings", [{"seed": 1}, {"changes": {"replicas": 8}}, {"changes": {"device": "cuda:0"}}]
)
def test_other_random_numbers_are_not_paired(add, settings):
    found = compared(add(GOOD), add(BAD, **DQN, **settings))
    assert (found.pairs, found.differences) == (0, {})


def test_only_seeds_with_a_partner_count(add):
    values = [{"agent.prior_std": std} for std in (0.05, 0.2)]
    run = add([0.5, 0.6], values=values, prior_std=[0.05, 0.2])
    small, large, dqn = read_groups([run, add([0.25, 0.5], **DQN)])
    assert pair(small, large).pairs == 0
    assert pair(small, dqn).differences["final"] == [0.25]
    assert pair(large, dqn).differences["final"] == pytest.approx([0.1])


def test_p_values_count_comparisons_that_were_not_run():
    alone, with_others = adjusted([[0.1, 0.2, 0.3]]), adjusted([[0.1, 0.2, 0.3], (), [0.5]])
    assert with_others == pytest.approx([3 * alone[0], 1, 1])
