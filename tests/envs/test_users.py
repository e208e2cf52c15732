"""The key ``env.users``: from the command line to the dialogues, and back from a saved state."""

from __future__ import annotations

import json

import torch

from bbq_torchrl.cli.evaluate import main
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, scripted_policy
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.folders import load_config, save_config

MIX = [{"share": 0.25, "tells": [1, 2], "insists": 1}, {"share": 0.75, "changes_mind": 0.5}]
TEXT = "[{share: .25, tells: [1, 2], insists: 1}, {share: .75, changes_mind: .5}]"


def test_a_mix_of_the_command_line_is_that_of_the_saved_configuration(tmp_path):
    for text, value in ((TEXT, MIX), ("{tells: [1, 1]}", {"tells": [1, 1]}), ("people", "people")):
        config = compose([f"env.users={text}"])
        assert config.env.users == value
        save_config(config, tmp_path / "config.yaml")
        assert load_config(tmp_path / "config.yaml") == config


def test_an_evaluation_plays_with_the_users_that_it_names(capsys):
    main(["policy=careful", "dialogues=60", "batch=60", "env.users={patience: [3, 3]}"])
    assert json.loads(capsys.readouterr().out)["success_rate"] == 0


def test_dialogues_continue_bit_for_bit_from_a_saved_state(movie, tmp_path):
    one, other = (DialogueEnv(movie, batch_size=(2, 9), seed=seed, users=MIX) for seed in (0, 1))
    policy = scripted_policy("careful", one)
    one.rollout(4, policy)
    torch.save(one.state_dict(), tmp_path / "state.pt")
    other.load_state_dict(torch.load(tmp_path / "state.pt", weights_only=True))
    seen = one.reset(resume=True)
    assert (seen == other.reset(resume=True)).all()
    for _ in range(20):
        action = policy(seen)
        seen = one.step(action.clone())["next"]
        assert (seen == other.step(action)["next"]).all()
        assert (one.dialogues == other.dialogues).all()
    assert (one.reset() == other.reset()).all()


def test_users_play_in_the_domain_extension(movie):
    env = DialogueEnv(
        movie,
        batch_size=(50,),
        seed=0,
        users="people",
        schedule=ExtensionSchedule(start=1, every=1),
    )
    for round_number in (0, 3):
        env.set_round(round_number)
        env.rollout(30, break_when_any_done=False)
        wanted = env.dialogues["constraints"] != 0
        assert wanted.any()
        assert not (wanted & ~env.active_slots).any()


def test_gymnasium_plays_with_users():
    from bbq_torchrl.envs.gymnasium import GymnasiumDialogue

    env = GymnasiumDialogue(users={"patience": [2, 2]}, seed=0)
    env.reset()
    ends = [env.step(env.domain.action_index("greeting"))[2] for _ in range(3)]
    assert ends == [False, False, True]
