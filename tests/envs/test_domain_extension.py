"""Domain extension: slots, actions, goals and features that come in the course of training."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torchrl.envs import ActionMask, TransformedEnv

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule

PAPER = [40, 50, 60, 70, 80, 90, 100, 110, 120, 130]


def active_names(env):
    flags = env.active_slots.tolist()
    return {slot for slot, flag in zip(env.domain.slots, flags, strict=True) if flag}


def test_a_slot_comes_every_ten_rounds_after_forty(movie):
    schedule = ExtensionSchedule()
    essential = set(movie.essential)
    assert set(schedule.active(movie, 0)) == set(schedule.active(movie, 39)) == essential
    assert schedule.additions(movie) == dict(zip(PAPER, movie.extension_order, strict=True))
    for position, round_number in enumerate(PAPER):
        added = set(movie.extension_order[: position + 1])
        assert set(schedule.active(movie, round_number)) == essential | added
        assert set(schedule.active(movie, round_number + 9)) == essential | added
    assert set(schedule.active(movie, 10_000)) == essential | set(movie.extension_order)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": -1}, "start must be a round, 0 or later, got -1"),
        ({"every": 0}, "every must be at least 1 round, got 0"),
    ],
)
def test_a_schedule_that_makes_no_sense_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        ExtensionSchedule(**settings)


def test_a_round_below_0_is_refused(movie):
    for schedule in (None, ExtensionSchedule()):
        with pytest.raises(ValueError, match="round must be 0 or later, got -1"):
            DialogueEnv(movie, schedule=schedule).set_round(-1)


def test_without_a_schedule_everything_is_there_from_the_start(movie):
    env = DialogueEnv(movie, batch_size=(3,), seed=0)
    for round_number in (0, 500):
        env.set_round(round_number)
        assert env.round == round_number
        assert active_names(env) == set(movie.slots)
        assert env.reset()["action_mask"].all()


def test_a_round_brings_its_actions(movie):
    env = DialogueEnv(movie, batch_size=(2, 2), seed=0, schedule=ExtensionSchedule())
    for round_number, count in ((0, 19), (39, 19), (40, 21), (50, 23)):
        env.set_round(round_number)
        mask = env.reset()["action_mask"]
        assert (mask.sum(-1) == count).all()
        names = active_names(env)
        legal = [action.slot is None or action.slot in names for action in movie.actions]
        assert mask[0, 0].tolist() == legal


def test_goals_and_features_know_only_the_active_slots(movie):
    env = DialogueEnv(movie, batch_size=(300,), seed=0, schedule=ExtensionSchedule())
    slots = torch.tensor([slot in movie.essential for slot in movie.slots])
    torch.manual_seed(0)
    rollout = env.rollout(10, break_when_any_done=False)
    assert not rollout["observation"][..., ~env.active_features].any()
    assert env.active_features.sum() < env.layout.size
    assert (env.dialogues["constraints"][:, ~slots] == 0).all()
    assert not env.dialogues["requests"][:, ~slots].any()
    ticket = movie.slots.index(movie.ticket_slot)
    assert env.dialogues["requests"][:, ticket].all()
    env.set_round(1_000)
    env.reset()
    assert (env.dialogues["constraints"][:, ~slots] != 0).any()


def test_dialogues_under_way_keep_their_goals(movie):
    env = DialogueEnv(movie, batch_size=(20,), seed=0, schedule=ExtensionSchedule())
    env.reset()
    before = env.dialogues["constraints"].clone()
    env.set_round(500)
    torch.manual_seed(0)
    env.rand_step(env.dialogues.select())
    assert torch.equal(env.dialogues["constraints"], before)


@pytest.mark.parametrize("transform", [None, ActionMask])
def test_random_actions_are_legal_in_every_round(movie, transform):
    env = DialogueEnv(movie, batch_size=(200,), seed=0, schedule=ExtensionSchedule())
    if transform is not None:
        env = TransformedEnv(env, transform())
    torch.manual_seed(0)
    for round_number in (0, 70, 0):
        env.set_round(round_number)
        rollout = env.rollout(4, break_when_any_done=False)
        mask = rollout["action_mask"]
        assert mask.gather(-1, rollout["action"][..., None]).all()
        assert rollout["action"].unique().numel() > 0.9 * int(mask[0, 0].sum())


def test_a_slot_with_actions_that_no_round_would_activate_is_refused(restaurant):
    domain = replace(restaurant, extension_order=("price_range", "phone"))
    with pytest.raises(ValueError, match=r"never activate restaurant, .* in essential or in exten"):
        DialogueEnv(domain, batch_size=(2,), schedule=ExtensionSchedule())
    DialogueEnv(domain, batch_size=(2,))


def test_slots_without_actions_may_stay_away(movie, restaurant):
    assert ExtensionSchedule().never_active(restaurant) == ("terrace",)
    assert "description" in ExtensionSchedule().never_active(movie)
