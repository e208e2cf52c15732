"""The scripted policies and the privileged one: their actions in different situations."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.domains import ScriptedPolicySpec, tensorize
from bbq_torchrl.domains.values import DONT_CARE
from bbq_torchrl.envs import (
    CarefulPolicy,
    ClairvoyantPolicy,
    DialogueEnv,
    ExtensionSchedule,
    UniformPolicy,
    scripted_policy,
)
from bbq_torchrl.trainers import evaluate, evaluation_rollouts


@pytest.fixture(scope="module")
def env(movie):
    return DialogueEnv(movie)


def played(env, policy):
    """Returns the policy's actions in each dialogue, to its end."""
    rollout = env.rollout(env.max_agent_turns, policy, break_when_any_done=False)
    lengths = rollout["next", "done"].squeeze(-1).long().argmax(1) + 1
    lines = zip(rollout["action"].tolist(), lengths.tolist(), strict=True)
    return [[env.domain.action_names[action] for action in line[:end]] for line, end in lines]


def test_the_rule_policy_plays_its_script_whatever_the_user_says(movie):
    env = DialogueEnv(movie, batch_size=(20,), seed=0, slot_error_prob=0.3)
    script = list(movie.policies["rule"].steps)
    assert played(env, scripted_policy("rule", env)) == [script] * 20


def test_the_random_policy_plays_every_legal_action_alike():
    torch.manual_seed(0)
    mask = torch.tensor([True, False, True, True, False]).expand(30_000, 5)
    action = UniformPolicy()(TensorDict(action_mask=mask, batch_size=[30_000]))["action"]
    share = torch.bincount(action, minlength=5) / 30_000
    assert share[[1, 4]].sum() == 0
    sigma = (1 / 3 * 2 / 3 / 30_000) ** 0.5
    assert (share[[0, 2, 3]] - 1 / 3).abs().max() < 5 * sigma


def test_an_unknown_policy_is_refused(env):
    with pytest.raises(ValueError, match=r"policy .*'clever'"):
        scripted_policy("clever", env)


@pytest.mark.parametrize(
    ("flags", "action"),
    [
        ("", "request(city)"),
        ("filled:city", "request(date)"),
        ("agent_requested:city", "request(date)"),
        ("agent_requested:date", "inform(taskcomplete)"),
        ("filled:city filled:date", "inform(taskcomplete)"),
        ("filled:city filled:date user_requested:theater", "inform(theater)"),
        ("filled:city filled:date user_requested:zip", "inform(taskcomplete)"),  # zip is masked
        ("user_requested:theater", "request(city)"),
        ("agent_act:inform", "inform(taskcomplete)"),
        ("agent_act:inform user_requested:theater", "inform(theater)"),
        ("agent_act:inform user_requested:ticket", "inform(taskcomplete)"),  # booked, not told
        ("agent_act:inform agent_informed:taskcomplete user_requested:theater", "thanks"),
    ],
)
def test_the_form_is_filled_in_order(movie, env, flags, action):
    observation = torch.tensor([[float(name in flags.split()) for name in env.layout.names]])
    legal = torch.tensor([["zip" not in name for name in movie.action_names]])
    td = TensorDict(observation=observation, action_mask=legal, batch_size=[1])
    policy = CarefulPolicy(env, ["city", "date", "zip"] if "zip" in flags else ["city", "date"])
    assert movie.action_names[policy(td)["action"]] == action


def test_a_script_that_needs_a_slot_of_a_later_round_is_refused_until_then(movie):
    script = ScriptedPolicySpec("script", ("request(city)", "request(genre)", "thanks"))
    domain = replace(movie, policies={"early": script})
    env = DialogueEnv(domain, batch_size=(2,), schedule=ExtensionSchedule(start=3))
    with pytest.raises(ValueError, match=r"early .*genre"):
        scripted_policy("early", env)
    env.set_round(3)
    assert played(env, scripted_policy("early", env)) == [list(script.steps)] * 2


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
