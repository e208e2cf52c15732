"""The scripted policies and the privileged one: their actions in different situations."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.domains import ScriptedPolicySpec, tensorize
from bbq_torchrl.domains.values import DONT_CARE
from bbq_torchrl.envs import (
    ClairvoyantPolicy,
    DialogueEnv,
    ExtensionSchedule,
    UniformPolicy,
    scripted_policy,
)
from bbq_torchrl.envs.policies import MAX_CONFIRMS, MAX_OFFERS, CarefulPolicy, RepairPolicy
from bbq_torchrl.trainers import evaluation_rollouts

SLOTS = ["city", "date", "zip"]
ANSWERED = "agent_act:inform agent_informed:theater"
OFFERED = "agent_act:inform agent_informed:taskcomplete kb_match:all"
FILLED = "filled:city filled:date"


@pytest.fixture(scope="module")
def env(movie):
    return DialogueEnv(movie)


def acts(env, kind, *turns):
    """Returns a policy's actions in the turns of a dialogue, given by set flags; zip is masked."""
    policy, tensordict, actions = kind(env, SLOTS), TensorDict(batch_size=[1]), []
    legal = torch.tensor([["zip" not in name for name in env.domain.action_names]])
    for flags in turns:
        assert set(flags.split()) <= {*env.layout.names}
        observation = torch.tensor([[float(name in flags.split()) for name in env.layout.names]])
        tensordict = policy(tensordict.update({"observation": observation, "action_mask": legal}))
        actions.append(env.domain.action_names[tensordict["action"]])
    return actions


def played(env, policy):
    """Returns the policy's actions in each dialogue, to its end."""
    rollout = env.rollout(env.max_agent_turns, policy, break_when_any_done=False)
    lengths = rollout["next", "done"].squeeze(-1).long().argmax(1) + 1
    lines = zip(rollout["action"].tolist(), lengths.tolist(), strict=True)
    return [[env.domain.action_names[action] for action in line[:end]] for line, end in lines]


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
def test_the_form_is_filled_in_order(env, flags, action):
    assert acts(env, CarefulPolicy, flags) == [action]


@pytest.mark.parametrize(
    ("turns", "action"),
    [
        (["user_requested:theater kb_match:all"], "request(theater)"),
        (["user_requested:zip kb_match:all"], "inform(ticket)"),  # zip is masked
        (["user_requested:ticket kb_match:all"], "inform(ticket)"),
        (["kb_match:all filled:ticket"], "confirm_answer"),
        # No record matches: requests repeat in order, except for answered and masked slots.
        (["filled:date filled:zip"], "request(date)"),
        (["", f"{FILLED} agent_act:request agent_requested:city"], "request(date)"),
        (
            ["", *[f"{FILLED} agent_act:request agent_requested:{s}" for s in SLOTS]],
            "request(city)",
        ),
        (["", f"{ANSWERED} {FILLED} user_requested:genre"], "inform(genre)"),
        # A record matches.
        (["", f"agent_act:request {FILLED} kb_match:all user_requested:price"], "inform(price)"),
        (["", f"{ANSWERED} kb_match:all"], "inform(ticket)"),
        (["", f"{ANSWERED} kb_match:all filled:ticket"], "confirm_answer"),
        (["", f"{ANSWERED} kb_match:all user_act:thanks"], "inform(taskcomplete)"),
        # An offer was made.
        (["", f"{OFFERED} user_act:thanks {FILLED} user_requested:price"], "thanks"),
        (["", f"{OFFERED} user_act:deny {FILLED}"], "request(city)"),
        (["", f"{OFFERED} user_act:deny filled:ticket"], "confirm_answer"),
        (["", f"{OFFERED} user_act:deny {FILLED}", f"{ANSWERED} {FILLED}"], "request(city)"),
    ],
)
def test_the_first_reason_that_there_is_to_repair_decides(env, turns, action):
    assert acts(env, RepairPolicy, *turns)[-1] == action


def test_repair_continues_and_offers_a_limited_number_of_times(env):
    silent = "agent_act:confirm_answer kb_match:all filled:ticket"
    played = acts(env, RepairPolicy, "kb_match:all filled:ticket", *[silent] * MAX_CONFIRMS)
    assert played == ["confirm_answer"] * MAX_CONFIRMS + ["inform(taskcomplete)"]
    over, denied = "agent_act:inform user_act:thanks kb_match:all", f"{OFFERED} user_act:deny"
    assert acts(env, RepairPolicy, "", over, *[denied] * MAX_OFFERS)[1:] == (
        ["inform(taskcomplete)"] * MAX_OFFERS + ["thanks"]
    )


def test_after_a_denial_every_filled_slot_is_asked_once(env):
    asked = [
        f"{FILLED} kb_match:all filled:ticket agent_act:request agent_requested:{slot}"
        for slot in ("city", "date")
    ]
    denied = f"{OFFERED} {FILLED} user_act:deny filled:ticket"
    done = f"{FILLED} kb_match:all agent_act:inform user_act:thanks filled:ticket"
    assert acts(env, RepairPolicy, "", done, denied, *asked, denied)[1:] == [
        *("inform(taskcomplete)", "request(city)", "request(date)"),
        *("inform(taskcomplete)", "request(city)"),
    ]


def test_repair_decides_by_what_is_observed_alone_and_forgets_where_a_dialogue_begins(movie):
    env = DialogueEnv(movie, batch_size=(50,), seed=0, slot_error_prob=0.2)
    policy = scripted_policy("repair", env)
    rollout = env.rollout(40, policy, break_when_any_done=False)  # several dialogues each
    begins = rollout["turns"].squeeze(-1) == 0
    assert begins.sum(1).min() > 1
    first = rollout[begins]["memory"]
    assert not any(entry.any() for entry in first.values())
    again = TensorDict(batch_size=[50])
    for step in rollout.unbind(1):
        again = policy(again.update(step.select("observation", "action_mask")))
        assert torch.equal(again["action"], step["action"])


def test_a_memory_that_was_lost_on_the_way_is_missed(movie):
    env = DialogueEnv(movie, batch_size=(3,), seed=0)
    policy = scripted_policy("repair", env)
    after = env.step(policy(env.reset()))["next"]
    with pytest.raises(ValueError, match="'memory'"):
        policy(after)


def test_a_script_is_played_once_the_round_has_its_slots(movie):
    script = ScriptedPolicySpec("script", ("request(city)", "request(genre)", "thanks"))
    domain = replace(movie, policies={"early": script})
    schedule = ExtensionSchedule(start=3)
    env = DialogueEnv(domain, batch_size=(20,), schedule=schedule, slot_error_prob=0.3)
    with pytest.raises(ValueError, match=r"early .*genre"):
        scripted_policy("early", env)
    env.set_round(3)
    assert played(env, scripted_policy("early", env)) == [list(script.steps)] * 20


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


@pytest.mark.parametrize("name", ["clairvoyant", "repair"])
def test_it_plays_legal_actions_in_every_round_of_domain_extension(movie, name):
    env = DialogueEnv(movie, batch_size=(2, 100), seed=0, schedule=ExtensionSchedule())
    for entered in (0, 90, 200):
        env.set_round(entered)
        (rollout,) = evaluation_rollouts(env, scripted_policy(name, env), 100)
        assert rollout["action_mask"].gather(-1, rollout["action"][..., None]).all()
        assert rollout["next", "success"].any(2).double().mean() > 0.7
