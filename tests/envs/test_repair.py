"""The policy that asks again: its actions in different situations, and its memory."""

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.envs import DialogueEnv, RepairPolicy, scripted_policy
from bbq_torchrl.envs.policies import MAX_CONFIRMS, MAX_OFFERS

SLOTS = ["city", "date", "zip"]
ANSWERED = "agent_act:inform agent_informed:theater"
OFFERED = "agent_act:inform agent_informed:taskcomplete kb_match:all"
FILLED = "filled:city filled:date"


@pytest.fixture(scope="module")
def env(movie):
    return DialogueEnv(movie)


def acts(env, *turns):
    """Returns the actions in the turns of a dialogue, each given by its set flags."""
    policy, tensordict, actions = RepairPolicy(env, SLOTS), TensorDict(batch_size=[1]), []
    for flags in turns:
        assert set(flags.split()) <= {*env.layout.names}
        observation = torch.tensor([[float(name in flags.split()) for name in env.layout.names]])
        legal = torch.tensor([["zip" not in name for name in env.domain.action_names]])
        tensordict = policy(tensordict.update({"observation": observation, "action_mask": legal}))
        actions.append(env.domain.action_names[tensordict["action"]])
    return actions


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
def test_the_first_reason_that_there_is_decides(env, turns, action):
    assert acts(env, *turns)[-1] == action


def test_it_continues_and_offers_a_limited_number_of_times(env):
    silent = "agent_act:confirm_answer kb_match:all filled:ticket"
    played = acts(env, "kb_match:all filled:ticket", *[silent] * MAX_CONFIRMS)
    assert played == ["confirm_answer"] * MAX_CONFIRMS + ["inform(taskcomplete)"]
    over, denied = "agent_act:inform user_act:thanks kb_match:all", f"{OFFERED} user_act:deny"
    assert acts(env, "", over, *[denied] * MAX_OFFERS)[1:] == (
        ["inform(taskcomplete)"] * MAX_OFFERS + ["thanks"]
    )


def test_after_a_denial_every_filled_slot_is_asked_once(env):
    asked = [
        f"{FILLED} kb_match:all filled:ticket agent_act:request agent_requested:{slot}"
        for slot in ("city", "date")
    ]
    denied = f"{OFFERED} {FILLED} user_act:deny filled:ticket"
    done = f"{FILLED} kb_match:all agent_act:inform user_act:thanks filled:ticket"
    assert acts(env, "", done, denied, *asked, denied)[1:] == [
        *("inform(taskcomplete)", "request(city)", "request(date)"),
        *("inform(taskcomplete)", "request(city)"),
    ]


def test_it_decides_by_what_is_observed_alone_and_forgets_where_a_dialogue_begins(movie):
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
