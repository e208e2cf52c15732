"""The spike: the dialogues that fill the buffers before the first round, and their lifetime."""

from __future__ import annotations

import pytest
from trainer_parts import make_trainer, random_policy

from bbq_torchrl.trainers import Spike, SpikeError


def states(trainer):
    """The observations in each replica's buffer."""
    return [set(map(tuple, b[:]["observation"].tolist())) for b in trainer.replay.buffers]


@pytest.mark.parametrize("dialogues", [8, 13])
def test_it_fills_every_replica_with_separate_dialogues(tmp_path, dialogues):
    trainer = make_trainer(tmp_path, spike=Spike(random_policy, dialogues))

    trainer.begin()

    assert trainer.replay.protected == trainer.replay.lengths
    assert len(set.union(*states(trainer))) == sum(map(len, states(trainer)))
    for buffer in trainer.replay.buffers:
        assert int(buffer[:]["next", "done"].sum()) == dialogues


def test_a_replica_without_a_success_is_reported(tmp_path, caplog):
    def second_guesses(tensordict):
        tensordict = random_policy(tensordict)
        tensordict["action"][[0, 2]] = 1
        return tensordict

    for name, policy in {"guess": random_policy, "second guesses": second_guesses}.items():
        make_trainer(tmp_path / name, capacity=400, spike=Spike(policy, 20)).begin()
    told = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert [message.partition("replica ")[2] for message in told] == ["0, 2 succeeds"]


@pytest.mark.parametrize("protect", [True, False])
def test_it_is_protected_by_default_and_evicted_otherwise(tmp_path, protect):
    spike = Spike(random_policy, 5) if protect else Spike(random_policy, 5, protect=False)
    trainer = make_trainer(tmp_path, rounds=6, capacity=40, spike=spike)
    trainer.begin()
    spiked = states(trainer)
    while trainer.rounds_done < 6:
        trainer.train_round()

    assert trainer.replay.lengths == (40, 40, 40)
    for before, after in zip(spiked, states(trainer), strict=True):
        assert before & after == (before if protect else set())


def test_one_that_fills_the_capacity_is_refused(tmp_path):
    trainer = make_trainer(tmp_path, capacity=40, spike=Spike(random_policy, 80))

    with pytest.raises(SpikeError):
        trainer.train()
    assert not (tmp_path / "checkpoint").exists()
