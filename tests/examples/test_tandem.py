"""The tandem example: the active agent does not notice, the passive one learns from its data."""

import copy
import sys

import pytest
import torch
from tiny import rows

from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer

TINY = (
    "replicas=2",
    "agent.hidden=[16]",
    "protocol.rounds=2",
    "protocol.dialogues=6",
    "protocol.epochs=1",
    "protocol.eval_every=1",
    "protocol.eval_every_dialogues=20",
    "protocol.batch_size=256",
    "spike.dialogues=20",
)


@pytest.fixture
def example(names_of):
    return names_of("tandem")


def same_weights(trainer, weights):
    """Whether a trainer's loss has these weights."""
    return all(
        torch.equal(value, weights[key]) for key, value in trainer.learner.loss.state_dict().items()
    )


def test_the_active_agents_rounds_are_those_of_an_ordinary_run(example, tmp_path):
    trainers = example["make_trainers"]("bbqn_map", "dqn", TINY, tmp_path)
    rows = [row for part in example["tandem"](*trainers) for row in part]
    protocol = example["PROTOCOL"]
    config = compose([f"+experiment=[agents/bbqn_map,{protocol}]", *TINY])
    alone = build_trainer(config, tmp_path / "alone")[0].train()
    watched = read_metrics(tmp_path / "active")
    for name in ("loss", "reward", "eval_success_rate"):
        assert watched[name].ravel().tolist() == [row[name] for row in alone]
    assert [row for row in rows if row[0] == "active"] == [
        ("active", row["round"] + 1, row["replica"], row["eval_success_rate"]) for row in alone
    ]


def test_an_agent_in_tandem_with_itself_learns_what_the_active_one_does(example, tmp_path):
    active, passive = example["make_trainers"]("dqn", "dqn", TINY, tmp_path)
    begun = copy.deepcopy(active.learner.loss.state_dict())
    for played in example["tandem"](active, passive):
        rates = {
            role: [row[3] for row in played if row[0] == role] for role in ("active", "passive")
        }
        assert rates["active"] == rates["passive"]
    assert same_weights(active, passive.learner.loss.state_dict())
    assert not same_weights(active, begun)


@pytest.mark.slow
def test_the_file_has_a_line_for_each_agent_evaluation_and_replica(example, tmp_path, monkeypatch):
    file = tmp_path / "tandem.csv"
    monkeypatch.setattr(sys, "argv", ["tandem.py", f"--file={file}", *TINY, "protocol.rounds=1"])
    example["main"]()
    lines = rows(file)
    assert [(line["agent"], line["rounds"], line["replica"]) for line in lines] == [
        (agent, "1", replica) for agent in ("bbqn_map", "dqn") for replica in ("0", "1")
    ]
