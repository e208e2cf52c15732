"""The privileged policy books whatever can be booked."""

import pytest
import torch

from bbq_torchrl.domains import DONT_CARE, tensorize
from bbq_torchrl.envs import ClairvoyantPolicy, DialogueEnv, ExtensionSchedule, scripted_policy
from bbq_torchrl.evaluation.rollouts import evaluate, evaluation_rollouts


def can_be_met(domain):
    """Returns, for each goal, whether a record meets its constraints and answers its requests."""
    tensors = tensorize(domain)
    records = tensors.records[None]
    wanted, requested = tensors.goal_constraints[:, None], tensors.goal_requests[:, None].clone()
    requested[..., tensors.ticket] = False
    fits = (wanted <= DONT_CARE) | ~tensors.constrains | (records == wanted)
    return (fits & (~requested | (records != 0))).all(-1).any(-1)


@pytest.mark.parametrize("corpus", ["movie", "restaurant"])
def test_without_errors_exactly_the_goals_that_a_record_meets_are_booked(corpus, request):
    domain = request.getfixturevalue(corpus)
    env = DialogueEnv(domain, batch_size=(1000,), seed=0, slot_error_prob=0.0)
    (rollout,) = evaluation_rollouts(env, ClairvoyantPolicy(env), 1000)
    expected = can_be_met(domain)[rollout["goal_id"][:, 0, 0]]
    assert expected.any()
    assert torch.equal(rollout["next", "success"].any(1).squeeze(-1), expected)


def test_it_plays_one_dialogue_as_a_batch_of_one(movie):
    actions = []
    for batch in ((), (1,)):
        env = DialogueEnv(movie, batch_size=batch, seed=0, slot_error_prob=0.3)
        policy = ClairvoyantPolicy(env)
        plays = [env.rollout(env.max_agent_turns, policy)["action"].flatten() for _ in range(6)]
        actions.append(torch.cat(plays))
    assert torch.equal(*actions)


@pytest.mark.parametrize(
    ("mode", "share"),
    # In mode slot, errors also fill slots that the agent informs and never requests.
    [("value", 0.9), ("slot", 0.7)],
)
def test_what_was_misheard_is_asked_again(movie, mode, share):
    env = DialogueEnv(movie, batch_size=(500,), seed=0, slot_error_prob=0.2, slot_error_mode=mode)
    own, careful = (
        evaluate(env, scripted_policy(name, env), 500).success.double().mean()
        for name in ("clairvoyant", "careful_essential")
    )
    assert own > share * can_be_met(movie).double().mean()
    assert own > careful + 0.2


@pytest.mark.parametrize("name", ["clairvoyant", "repair"])
def test_it_plays_legal_actions_in_every_round_of_domain_extension(movie, name):
    env = DialogueEnv(movie, batch_size=(2, 100), seed=0, schedule=ExtensionSchedule())
    for entered in (0, 90, 200):
        env.set_round(entered)
        (rollout,) = evaluation_rollouts(env, scripted_policy(name, env), 100)
        assert rollout["action_mask"].gather(-1, rollout["action"][..., None]).all()
        assert rollout["next", "success"].any(2).double().mean() > 0.7
