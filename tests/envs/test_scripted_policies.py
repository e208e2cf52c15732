"""The scripted policies: what they play in which situation."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, scripted_policy
from bbq_torchrl.envs.scripted import CarefulPolicy, SequencePolicy, UniformPolicy


def played(env, policy):
    """Returns what the policy plays in each dialogue, as text, to the end of it."""
    rollout = env.rollout(
        env.max_agent_turns, policy, break_when_any_done=False, break_when_all_done=True
    )
    names = env.domain.action_names
    lines = []
    for actions, done in zip(rollout["action"], rollout["next", "done"].squeeze(-1), strict=True):
        length = int(done.long().argmax()) + 1
        lines.append([names[action] for action in actions[:length].tolist()])
    return lines


def test_the_rule_policy_plays_its_script_whatever_the_user_says(movie):
    env = DialogueEnv(movie, batch_size=(20,), seed=0, slot_error_prob=0.3)
    script = list(movie.policies["rule"].steps)
    assert played(env, scripted_policy("rule", env)) == [script] * 20


def test_a_script_repeats_its_last_action():
    policy = SequencePolicy([3, 5], turns_key=("info", "turns"), action_key="choice")
    td = TensorDict({"info": {"turns": torch.tensor([[0], [1], [2], [7]])}}, batch_size=[4])
    assert policy(td)["choice"].tolist() == [3, 5, 5, 5]
    with pytest.raises(ValueError, match="at least one action, got none"):
        SequencePolicy([])


def test_the_careful_policy_asks_what_is_unfilled_answers_offers_and_ends(movie):
    env = DialogueEnv(movie, batch_size=(300,), seed=0, slot_error_prob=0.0)
    slots = list(movie.policies["careful"].steps)
    filled = env.reset()["observation"][:, env.layout["filled"]] > 0
    env.set_seed(0)
    dialogues = played(env, scripted_policy("careful", env))
    for line, known in zip(dialogues, filled, strict=True):
        requests = [step[8:-1] for step in line if step.startswith("request(")]
        answers = line[len(requests) : -2]
        assert line[-2:] == ["inform(taskcomplete)", "thanks"]
        assert all(step.startswith("inform(") for step in answers)
        assert "inform(ticket)" not in answers
        assert requests == [slot for slot in slots if slot in requests]
        assert not any(known[movie.slots.index(slot)] for slot in requests)
    assert any("inform(theater)" in line for line in dialogues)
    assert len({len(line) for line in dialogues}) > 3


def test_the_careful_policy_leaves_illegal_requests_out(movie):
    env = DialogueEnv(
        movie, batch_size=(50,), seed=0, slot_error_prob=0.0, schedule=ExtensionSchedule()
    )
    for line in played(env, scripted_policy("careful", env)):
        slots = {step.partition("(")[2].rstrip(")") for step in line} - {""}
        assert slots <= set(movie.essential)


def test_every_domain_brings_its_own_policies(restaurant):
    env = DialogueEnv(restaurant, batch_size=(200,), seed=0, slot_error_prob=0.0)
    rates = {}
    for name in ("random", *restaurant.policies):
        env.set_seed(0)
        torch.manual_seed(0)
        rollout = env.rollout(
            env.max_agent_turns,
            scripted_policy(name, env),
            break_when_any_done=False,
            break_when_all_done=True,
        )
        rates[name] = rollout["next", "success"].any(1).double().mean().item()
    assert rates["random"] < rates["rule"] < rates["careful"]


def test_the_random_policy_plays_every_legal_action_alike():
    torch.manual_seed(0)
    mask = torch.tensor([True, False, True, True, False]).expand(30_000, 5)
    action = UniformPolicy()(TensorDict(action_mask=mask, batch_size=[30_000]))["action"]
    share = torch.bincount(action, minlength=5) / 30_000
    assert share[[1, 4]].sum() == 0
    sigma = (1 / 3 * 2 / 3 / 30_000) ** 0.5
    assert (share[[0, 2, 3]] - 1 / 3).abs().max() < 5 * sigma


def test_an_unknown_policy_is_refused(movie):
    env = DialogueEnv(movie)
    with pytest.raises(ValueError, match=r"policy must be one of random, rule, .* got 'clever'"):
        scripted_policy("clever", env)


FORM = {
    # observation: requested 0 1, filled 2 3, asked 4, answered 5, completed 6
    "request_actions": [10, 11],
    "requested_columns": [0, 1],
    "filled_columns": [2, 3],
    "answer_actions": [12],
    "asked_columns": [4],
    "answered_column": 5,
    "complete_action": 13,
    "complete_column": 6,
    "end_action": 14,
}


@pytest.mark.parametrize(
    ("flags", "action"),
    [
        ((), 10),
        ((2,), 11),
        ((0,), 11),
        ((1,), 13),
        ((2, 3), 13),
        ((2, 3, 4), 12),
        ((4,), 10),
        ((5,), 13),
        ((5, 4), 12),
        ((5, 6, 4), 14),
    ],
)
def test_the_form_is_filled_in_order(flags, action):
    observation = torch.tensor([[float(column in flags) for column in range(7)]])
    td = TensorDict(observation=observation, batch_size=[1])
    assert CarefulPolicy(**FORM, mask_key=None)(td)["action"].tolist() == [action]


def test_an_illegal_answer_is_left_out():
    td = TensorDict(
        observation=torch.tensor([[0.0, 0, 1, 1, 1, 0, 0]]),
        action_mask=torch.arange(15)[None] != 12,
        batch_size=[1],
    )
    assert CarefulPolicy(**FORM)(td)["action"].tolist() == [13]


def test_a_policy_without_answers_offers_at_once():
    form = FORM | {"answer_actions": [], "asked_columns": []}
    td = TensorDict(observation=torch.tensor([[0.0, 0, 1, 1, 1, 0, 0]]), batch_size=[1])
    assert CarefulPolicy(**form, mask_key=None)(td)["action"].tolist() == [13]


def test_columns_that_do_not_fit_their_actions_are_refused():
    with pytest.raises(ValueError, match="filled_columns must have one column for each of the 2"):
        CarefulPolicy(**FORM | {"filled_columns": [2]})
