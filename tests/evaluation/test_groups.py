"""Runs of one setting are a group with a label, and groups of one seed are compared by pairs."""

import pytest
import torch
from tiny import TINY, composed

from bbq_torchrl.evaluation.finished_runs import agent_name
from bbq_torchrl.evaluation.groups import pair, read_groups, references
from bbq_torchrl.runs.train import build_trainer


def test_runs_that_differ_in_their_seed_alone_are_one_group(add):
    other = add([0.1], agent="dqn")
    bbqn, dqn = read_groups([add([0.5, 0.6], seed=0), other, add([0.7], seed=1)])
    assert (bbqn.label, dqn.label) == ("BBQN-MAP", "DQN")
    assert bbqn.final == [0.5, 0.6, 0.7]
    assert bbqn.cumulative == pytest.approx([0.25, 0.3, 0.35])
    assert bbqn.success.tolist() == [[0.25, 0.3, 0.35]] * 3
    assert (bbqn.reward, bbqn.turns, bbqn.dialogues) == (10, 8, 150)
    assert dqn.final == [0.1]


@pytest.mark.parametrize(
    ("others", "labels"),
    [
        ([{"prior_std": 0.05}], ["BBQN-MAP, agent.prior_std=0.05"]),
        ([{"target": "mc"}], ["BBQN-MC"]),
        ([{"rounds": 2}], ["BBQN-MAP, protocol.rounds=2"]),
        ([{"changes": {"explore.per": None}}], ["BBQN-MAP, explore.per=null"]),
        # An option is named instead of its keys, unless two settings of it are there.
        (
            [{"explore": "epsilon_greedy"}, {"explore": "epsilon_greedy", "eps": 1}],
            ["BBQN-MAP, explore=epsilon_greedy", "BBQN-MAP, explore=epsilon_greedy, agent.eps=1"],
        ),
        (
            [{"explore": "greedy", "changes": {"explore.per": per}} for per in ("a", "b")],
            ["BBQN-MAP, explore=greedy", "BBQN-MAP, explore=greedy, explore.per=b"],
        ),
        # The first of another agent is told by its name alone, whatever its own keys are.
        ([{"agent": "dqn"}, {"agent": "dqn", "dropout": 0.1}], ["DQN", "DQN, agent.dropout=0.1"]),
    ],
)
def test_a_label_says_what_tells_a_group_from_the_first(add, others, labels):
    first, *found = read_groups([add([0.5]), *(add([0.5], **other) for other in others)])
    assert first.label == "BBQN-MAP"
    assert [group.label for group in found] == labels


@pytest.mark.parametrize("stds", [[0.2, 0.2], [0.05, 0.2]])
def test_one_training_does_not_count_as_two_seeds(add, stds):
    one = add([0.7], seed=4, prior_std=0.2)
    values = [{"agent.prior_std": std} for std in stds]
    other = add([0.5, 0.6], seed=4, values=values, prior_std=stds)
    with pytest.raises(ValueError, match="seed"):
        read_groups([one, other])


def test_references_are_drawn_where_all_runs_have_the_same_users(add):
    known = {"clairvoyant": 0.8}
    privileged = "clairvoyant (privileged: it reads what no agent is shown)"
    first = add([0.5], references=known, scripted={"rule": 0.2, "repair": 0.7})
    other = add([0.5], seed=1, references={"clairvoyant": 0.7}, scripted={"rule": 0.3})
    fewer = add([0.5], seed=2)
    harder = add([0.5], references=known, changes={"env.slot_error_prob": 0.3})
    script = {"repair (best script measured)": pytest.approx(0.7)}
    assert references(read_groups([first, other])) == {privileged: pytest.approx(0.75), **script}
    assert references(read_groups([first, other, fewer])) == script
    assert references(read_groups([first, harder])) == {}


NONE, VIME = {"name": "none"}, {"name": "vime", "weights": "map"}


@pytest.mark.parametrize(
    ("agent", "keys", "explore", "intrinsic", "name"),
    [
        # a target and a gain that differ are both named
        ("bbqn", {"target": "mc"}, "thompson", VIME, "BBQN-MC-VIME-MAP"),
        ("dqn", {"double": True}, "boltzmann", NONE, "Double DQN-Boltzmann"),
        # a name leaves out the keys of a user's options
        ("polyak", {"target": 0.005, "noisy": 0.1}, "greedy", NONE, "POLYAK, explore=greedy"),
        ("bbqn", {"target": "mc"}, "thompson", VIME | {"name": "novelty"}, "BBQN-MC-NOVELTY"),
    ],
)
def test_an_agent_is_named_by_the_keys_that_the_paper_has(agent, keys, explore, intrinsic, name):
    config = {"agent": {"name": agent, **keys}, "explore": {"name": explore}}
    assert agent_name(config | {"intrinsic": intrinsic}) == name


GOOD = [0.70, 0.80, 0.75, 0.72, 0.78]
BAD = [0.50, 0.40, 0.60, 0.55, 0.45]
DQN = {"agent": "dqn"}


def compared(*folders):
    """The one pairing of the two groups that the folders make."""
    return pair(*read_groups(folders))


def test_the_same_replica_of_two_agents_sees_the_same_dialogues(tmp_path):
    spiked, goals = [], []
    for agent in ("bbqn", "dqn"):
        trainer, _ = build_trainer(
            composed(*TINY, f"agent={agent}", "replicas=2"), tmp_path / agent
        )
        trainer.begin()
        buffers = trainer.replay.buffers
        spiked.append([buffer[:].select("observation", "action") for buffer in buffers])
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
    ("settings", "pairs", "different"),
    [
        ({"changes": {"env.name": "grows", "env.start": 40}}, 5, ["env.name (full, grows)"]),
        ({"changes": {"spike.dialogues": 50}}, 5, ["spike.dialogues (100, 50)"]),
        ({"rounds": 4}, 5, ["protocol.rounds (3, 4)"]),
        # the same dialogues, learned from in another way
        ({"changes": {"spike.protect": False}}, 5, []),
        ({"changes": {"protocol.batch_size": 128}}, 5, []),
        # other random numbers
        *(({"seed": 1}, 0, []), ({"changes": {"replicas": 8}}, 0, [])),
        ({"changes": {"device": "cuda:0"}}, 0, []),
    ],
)
def test_pairs_name_the_keys_that_change_the_dialogues_and_need_the_same_random_numbers(
    add, settings, pairs, different
):
    found = compared(add(GOOD), add(BAD, **DQN, **settings))
    assert (found.pairs, found.different) == (pairs, different)
    assert bool(found.differences) == (pairs > 0)
