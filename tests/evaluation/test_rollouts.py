"""Evaluations play the dialogues that were asked for, and transcripts are of those."""

import pytest
import torch

from bbq_torchrl.cli.evaluate import transcripts
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


@pytest.mark.parametrize("name", ["careful", "random"])
def test_transcripts_are_of_the_dialogues_that_are_counted(env, name):
    policy = scripted_policy(name, env)
    dialogues = 2 * PLACES - 1
    played = evaluate(env, policy, dialogues, seed=9)
    texts = transcripts(env, policy, dialogues, seed=9)
    assert len(texts) == dialogues
    for number, text in enumerate(texts):
        head, *turns, end = text.splitlines()
        assert head.startswith(f"dialogue {number + 1}: ")
        assert end.strip() == ("success" if played.success[0, number] else "failure")
        agent = [line for line in turns if line.startswith("  agent: ")]
        user = [line for line in turns if line.startswith("  user: ")]
        assert len(agent) == played.turns[0, number]
        assert len(user) == len(agent) + 1
