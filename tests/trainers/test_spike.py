"""The spike: the dialogues that fill the buffers before the first round, and their lifetime."""

import pytest
import torch
from trainer_parts import GuessEnv, make_trainer, random_policy

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.trainers import Spike, SpikeError
from bbq_torchrl.trainers.collect import collect_dialogues


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


def test_without_one_the_newest_successes_stay_until_others_are_there():
    replay, loaded = (ReplicaReplay(150, replicas=3, successes=2) for _ in range(2))
    env = GuessEnv(3, 20)
    env.set_seed(0)
    torch.manual_seed(0)

    def successes(policy):
        collect_dialogues(replay, env, policy, 20, max_steps=9)
        loaded.load_state_dict(replay.state_dict())
        replay.load_state_dict(loaded.state_dict())
        rows = [buffer[:] for buffer in replay.buffers]
        return [row["observation"][row["next", "reward"][:, 0] > 3].tolist() for row in rows]

    first = successes(random_policy)
    assert all(len(own) > 2 for own in first)
    for _ in range(4):  # 140 turns each
        left = successes(lambda td: td.set("action", torch.ones(td.batch_size).long()))
    assert left == [own[-2:] for own in first]
    for _ in range(9):
        newer = successes(random_policy)
    assert all(len(own) > 2 and left[i][0] not in own for i, own in enumerate(newer))
