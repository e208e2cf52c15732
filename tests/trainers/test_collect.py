"""Dialogues played in lockstep, every one to its end; only real turns are counted."""

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import InitTracker, TransformedEnv
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import EGreedyModule
from trainer_parts import TURNS, GuessEnv, random_policy

from bbq_torchrl.data import TRANSITION_KEYS, BootstrapMask
from bbq_torchrl.protocols import Annealed, Measured, Resampled, Seeded, modules_with, provides
from bbq_torchrl.trainers import RoundEnv, episode_stats, rollout, rollouts
from bbq_torchrl.trainers.collect import rows_per_replica


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


def test_dialogues_are_not_chosen_by_their_length():
    turns = torch.cat(
        [episode_stats(r).turns.flatten() for r in rollouts(GuessEnv(1, 100), random_policy, 2950)]
    ).double()

    # A dialogue continues after each turn, up to the last one, with a probability of one half.
    expected = sum(0.5**k for k in range(TURNS))
    assert len(turns) == 2950
    assert abs(float(turns.mean()) - expected) < 5 * float(turns.std()) / 2950**0.5


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


class Counts(nn.Module):
    """A module with a buffer named like a hook, but without the method."""

    def __init__(self):
        super().__init__()
        self.register_buffer("step", torch.zeros(()))


GREEDY = EGreedyModule(GuessEnv(2, 3).action_spec, annealing_num_steps=10)


@pytest.mark.parametrize(
    ("owner", "protocol", "has_them"),
    [
        (TransformedEnv(GuessEnv(2, 3), InitTracker()), RoundEnv, True),
        (nn.Identity(), RoundEnv, False),
        (GREEDY, Annealed, True),
        (GREEDY, Resampled, False),
        (Counts(), Annealed, False),
        (BootstrapMask(2), Seeded, True),
        (BootstrapMask(2), Measured, False),
    ],
)
def test_optional_methods_are_found_by_name_without_inheritance(owner, protocol, has_them):
    assert provides(owner, protocol) is has_them


def test_a_wrapper_that_forwards_a_hook_is_not_called_too():
    policy = nn.Sequential(TensorDictModule(GREEDY, ["a"], ["b"]), Counts())
    assert modules_with(policy, Annealed) == [GREEDY]
