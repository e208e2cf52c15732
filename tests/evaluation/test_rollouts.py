"""Evaluations play the dialogues that were asked for."""

import pytest
import torch

from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.trainers import evaluate

PLACES = 6


@pytest.fixture
def env(movie):
    return DialogueEnv(movie, batch_size=(2, PLACES), seed=0)


def test_a_seed_decides_all_dialogues_whatever_was_played_before_or_follows(env):
    policy = scripted_policy("random", env)
    many, other = (evaluate(env, policy, 3 * PLACES, seed=seed) for seed in (5, 6))
    assert not torch.equal(many.turns, other.turns)
    assert (many.turns >= 1).all()
    for dialogues in (1, PLACES, PLACES + 1, 3 * PLACES):
        again = evaluate(env, policy, dialogues, seed=5)
        for few, all_ in zip(again, many, strict=True):
            assert torch.equal(few, all_[:, :dialogues])
