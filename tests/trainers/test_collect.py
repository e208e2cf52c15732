"""Dialogues played in lockstep: every one to its end, and only what is real is counted."""

from __future__ import annotations

import pytest
import torch
from torch import nn
from torchrl.envs.utils import ExplorationType, exploration_type
from trainer_parts import GuessEnv, never_guess, random_policy

from bbq_torchrl.data import TRANSITION_KEYS
from bbq_torchrl.trainers import episode_stats, rollout, rollouts
from bbq_torchrl.trainers.collect import rows_per_replica


def test_statistics_are_those_of_the_dialogues_played_one_by_one():
    torch.manual_seed(0)
    played = rollout(GuessEnv(2, 10), random_policy)

    result = episode_stats(played)

    for replica in range(2):
        for place in range(10):
            steps = played[replica, place]["next"]
            assert steps["done"].any()
            count = int(steps["done"].squeeze(-1).int().argmax()) + 1
            valid = played["valid"][replica, place].tolist()
            assert valid == [turn < count for turn in range(len(steps))]
            last = steps[count - 1]
            assert result.turns[replica, place] == count
            assert result.success[replica, place] == last["success"]
            rewards = steps["reward"][:count].double().sum()
            assert result.reward[replica, place] == pytest.approx(float(rewards), abs=1e-9)
    assert result.success.any()
    assert not result.success.all()


def test_rows_are_the_valid_transitions_of_each_replica_in_order():
    torch.manual_seed(0)
    played = rollout(GuessEnv(3, 6), random_policy)

    rows = rows_per_replica(played, TRANSITION_KEYS)

    for replica, td in enumerate(rows):
        expected = torch.cat(
            [d["observation"][: int(d["valid"].sum())] for d in played[replica].unbind(0)]
        )
        assert torch.equal(td["observation"], expected)
        assert set(td.keys(True, True)) == set(TRANSITION_KEYS)
        assert int(td["next", "done"].sum()) == 6


@pytest.mark.parametrize(("dialogues", "sizes"), [(4, [4]), (6, [4, 2]), (3, [3])])
def test_each_replica_plays_as_many_as_asked_for_and_is_told_where_each_begins(dialogues, sizes):
    batches = list(rollouts(GuessEnv(2, 4), random_policy, dialogues))

    assert [r.shape[:2] for r in batches] == [torch.Size([2, size]) for size in sizes]
    for played in batches:
        begins = played["is_init"].squeeze(-1)
        assert begins[..., 0].all()
        # a dialogue that is over repeats its last turn, which may be its first
        assert not (begins & played["valid"])[..., 1:].any()


def test_dialogues_are_not_chosen_by_their_length():
    # The mean length of a random guesser's dialogue in GuessEnv with 7 turns: sum of .5**k, k < 7.
    torch.manual_seed(0)
    turns = torch.cat(
        [episode_stats(r).turns.flatten() for r in rollouts(GuessEnv(1, 100), random_policy, 2950)]
    ).double()

    expected = sum(0.5**k for k in range(7))
    assert len(turns) == 2950
    assert abs(float(turns.mean()) - expected) < 5 * float(turns.std()) / 2950**0.5


def test_a_dialogue_that_does_not_end_is_an_error():
    with pytest.raises(RuntimeError, match="max_steps = 3 turns"):
        rollout(GuessEnv(1, 2), never_guess, max_steps=3)


class _Watcher(nn.Module):
    def forward(self, td):
        self.seen = (self.training, exploration_type(), torch.is_grad_enabled())
        return never_guess(td)


@pytest.mark.parametrize("exploration", [ExplorationType.RANDOM, ExplorationType.DETERMINISTIC])
@pytest.mark.parametrize("training", [True, False])
def test_the_policy_plays_in_evaluation_mode_and_gets_its_mode_back(exploration, training):
    policy = _Watcher().train(training)

    rollout(GuessEnv(1, 2), policy, exploration=exploration)

    assert policy.seen == (False, exploration, False)
    assert policy.training is training
