"""Dialogues played in lockstep, every one to its end, and the spike of the buffers."""

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import InitTracker, TransformedEnv
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import EGreedyModule
from trainer_parts import GuessEnv, make_trainer, random_policy

from bbq_torchrl.data import TRANSITION_KEYS, ReplicaReplay
from bbq_torchrl.protocols import Annealed, Resampled, RoundEnv, modules_with, provides
from bbq_torchrl.trainers import Spike, TrainingError, episode_stats, rollout, rollouts
from bbq_torchrl.trainers.collect import collect_dialogues, rows_per_replica


def test_statistics_and_rows_are_those_of_the_dialogues_played_one_by_one():
    played = rollout(GuessEnv(2, 10), random_policy)

    result = episode_stats(played)
    rows = rows_per_replica(played, TRANSITION_KEYS)

    for replica in range(2):
        dialogues = []
        for place in range(10):
            steps = played[replica, place]
            count = steps["next", "done"].flatten().tolist().index(True) + 1
            assert steps["valid"].tolist() == [turn < count for turn in range(len(steps))]
            dialogues.append(steps[:count])
            assert result.turns[replica, place] == count
            assert result.success[replica, place] == steps["next", "success"][count - 1]
            rewards = steps["next", "reward"][:count].double().sum()
            assert result.reward[replica, place] == pytest.approx(float(rewards), abs=1e-9)
        expected = torch.cat(dialogues).select(*TRANSITION_KEYS)
        assert (rows[replica] == expected).all()
    assert 0 < result.success.sum() < 20


@pytest.mark.parametrize(("dialogues", "sizes"), [(4, [4]), (6, [4, 2]), (3, [3])])
def test_each_replica_plays_as_many_as_asked_for_and_sees_where_each_begins(dialogues, sizes):
    batches = list(rollouts(GuessEnv(2, 4), random_policy, dialogues))

    assert [r.shape[:2] for r in batches] == [torch.Size([2, size]) for size in sizes]
    for played in batches:
        begins = played["is_init"].squeeze(-1)
        assert begins[..., 0].all()
        # a dialogue that is over repeats its last turn, which may be its first
        assert not (begins & played["valid"])[..., 1:].any()


class NeverGuesses(nn.Module):
    def forward(self, td):
        self.seen = (self.training, exploration_type(), torch.is_grad_enabled())
        return td.set("action", torch.ones(td.batch_size, dtype=torch.long))


def test_a_dialogue_that_does_not_end_is_an_error():
    with pytest.raises(RuntimeError, match="max_steps = 3 turns"):
        rollout(GuessEnv(1, 2), NeverGuesses(), max_steps=3)


@pytest.mark.parametrize("exploration", [ExplorationType.RANDOM, ExplorationType.DETERMINISTIC])
@pytest.mark.parametrize("training", [True, False])
def test_the_policy_plays_in_evaluation_mode_and_gets_its_mode_back(exploration, training):
    policy = NeverGuesses().train(training)

    rollout(GuessEnv(1, 2), policy, exploration=exploration)

    assert policy.seen == (False, exploration, False)
    assert policy.training is training


def test_optional_methods_are_found_by_name_through_wrappers_but_called_once():
    greedy = EGreedyModule(GuessEnv(2, 3).action_spec, annealing_num_steps=10)
    assert provides(TransformedEnv(GuessEnv(2, 3), InitTracker()), RoundEnv)
    assert provides(greedy, Annealed)
    assert not provides(greedy, Resampled)
    policy = nn.Sequential(TensorDictModule(greedy, ["a"], ["b"]), nn.Linear(2, 2))
    policy.register_buffer("step", torch.zeros(()))  # no method
    assert modules_with(policy, Annealed) == [greedy]


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
def test_it_is_protected_unless_that_is_not_wanted(tmp_path, protect):
    spike = Spike(random_policy, 5) if protect else Spike(random_policy, 5, protect=False)
    trainer = make_trainer(tmp_path, spike=spike)
    trainer.begin()

    replay = trainer.replay
    assert replay.protected == (replay.lengths if protect else (0, 0, 0))
    dialogues = [buffer[:] for buffer in replay.buffers]
    assert [int(own["next", "done"].sum()) for own in dialogues] == [5, 5, 5]
    states = torch.cat([own["observation"] for own in dialogues])
    assert len(states.unique(dim=0)) == len(states)  # each replica has its own dialogues


def test_one_that_fills_the_capacity_is_refused(tmp_path):
    trainer = make_trainer(tmp_path, capacity=40, spike=Spike(random_policy, 80))

    with pytest.raises(TrainingError):
        trainer.train()
    assert not (tmp_path / "checkpoint").exists()


def test_without_one_the_newest_successes_stay_until_others_are_there():
    replay, loaded = (ReplicaReplay(150, replicas=3, successes=2) for _ in range(2))
    env = GuessEnv(3, 20)
    env.set_seed(0)

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
