"""Domain extension: slots, actions, goals and features that are added during training."""

from dataclasses import replace

import pytest
import torch
from torchrl.envs import ActionMask, TransformedEnv

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule


def test_a_slot_comes_every_ten_rounds_after_forty(movie):
    schedule, paper = ExtensionSchedule(), range(40, 140, 10)
    assert schedule.additions(movie) == dict(zip(paper, movie.extension_order, strict=True))
    for round_number, added in ((0, 0), (39, 0), (40, 1), (49, 1), (50, 2), (10_000, 10)):
        active = {*movie.essential, *movie.extension_order[:added]}
        assert {*schedule.active(movie, round_number)} == active


def test_a_schedule_that_makes_no_sense_is_refused(restaurant):
    with pytest.raises(ValueError, match=r"start .*-1"):
        ExtensionSchedule(start=-1)
    with pytest.raises(ValueError, match=r"every .*0"):
        ExtensionSchedule(every=0)
    domain = replace(restaurant, extension_order=("price_range", "phone"))
    with pytest.raises(ValueError, match=r"restaurant.*extension_order"):
        DialogueEnv(domain, schedule=ExtensionSchedule())
    DialogueEnv(domain)


def test_slots_without_actions_may_stay_away(movie, restaurant):
    assert ExtensionSchedule().never_active(restaurant) == ("terrace",)
    assert "description" in ExtensionSchedule().never_active(movie)


@pytest.mark.parametrize(
    ("schedule", "legal"),
    [(None, {0: 39, 500: 39}), (ExtensionSchedule(), {0: 19, 39: 19, 40: 21, 50: 23})],
)
def test_a_round_brings_its_slots_and_their_actions(movie, schedule, legal):
    env = DialogueEnv(movie, batch_size=(2, 2), schedule=schedule)
    for round_number, count in legal.items():
        env.set_round(round_number)
        names = movie.slots if schedule is None else schedule.active(movie, round_number)
        assert env.round == round_number
        assert env.active_slots.tolist() == [slot in names for slot in movie.slots]
        mask = env.reset()["action_mask"]
        assert mask[0, 0].tolist() == [a.slot is None or a.slot in names for a in movie.actions]
        assert (mask.sum(-1) == count).all()


def test_goals_and_features_know_only_the_active_slots(movie):
    env = DialogueEnv(movie, batch_size=(300,), seed=0, schedule=ExtensionSchedule())
    away = ~env.active_slots
    rollout = env.rollout(10, break_when_any_done=False)
    assert not rollout["observation"][..., ~env.active_features].any()
    assert env.active_features.sum() < env.layout.size
    assert not env.dialogues["constraints"][:, away].any()
    assert not env.dialogues["requests"][:, away].any()
    assert env.dialogues["requests"][:, movie.slots.index(movie.ticket_slot)].all()
    before = env.dialogues["constraints"].clone()
    env.set_round(1_000)
    env.rand_step(env.dialogues.select())  # started dialogues keep their goals
    assert torch.equal(env.dialogues["constraints"], before)
    env.reset()
    assert env.dialogues["constraints"][:, away].any()


@pytest.mark.parametrize("transform", [None, ActionMask])
def test_random_actions_are_legal_in_every_round(movie, transform):
    env = DialogueEnv(movie, batch_size=(200,), seed=0, schedule=ExtensionSchedule())
    if transform is not None:
        env = TransformedEnv(env, transform())
    for round_number in (0, 70, 0):
        env.set_round(round_number)
        rollout = env.rollout(4, break_when_any_done=False)
        mask = rollout["action_mask"]
        assert mask.gather(-1, rollout["action"][..., None]).all()
        assert rollout["action"].unique().numel() > 0.9 * int(mask[0, 0].sum())
