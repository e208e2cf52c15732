"""The key ``env.users``: from the command line to the dialogues, and back from a saved state."""

import json

from bbq_torchrl.cli.evaluate import main
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
