"""The folder of a run and its saved configuration: loading it, and resuming with it."""

import dataclasses
import json

import pytest
from tiny import composed, prepared, resumed

from bbq_torchrl.cli import evaluate
from bbq_torchrl.runs.folders import load_config, restarted_config, save_config
from bbq_torchrl.settings import ConfigError

MIX = [{"share": 0.25, "tells": [1, 2], "insists": 1}, {"share": 0.75, "changes_mind": 0.5}]
TEXT = "[{share:.25,tells:[1,2],insists:1},{share:.75,changes_mind:.5}]"


@pytest.mark.parametrize(
    "command",
    [
        "agent=dqn env=domain_ext seed=3",
        "protocol=quick spike=none agent=bootstrap intrinsic=vime agent.lr=1e-5",
        f"env.users={TEXT}",
    ],
)
def test_a_saved_configuration_is_read_back_as_it_was(tmp_path, command):
    config = composed(*command.split())
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml") == config
    assert "tells" not in command or config.env.users == MIX


RUN = ("agent=dqn", "agent.gamma=[.8,.9]", "replicas=2", "threads=3", "protocol.rounds=5")


def test_a_resumed_run_has_its_own_configuration_but_for_what_may_change(tmp_path):
    save_config(composed(*RUN), tmp_path / "config.yaml")
    config = resumed(tmp_path, "agent=dqn", "seed=0", "threads=3")
    assert config == dataclasses.replace(composed(*RUN), resume=str(tmp_path))
    changes = ["protocol.rounds=9", "protocol.keep_checkpoints=all", "logger=wandb", "device=cuda"]
    changed = resumed(tmp_path, *changes, "logger.project=mine")
    assert changed == dataclasses.replace(
        composed(*RUN, *changes, "logger.project=mine"), resume=str(tmp_path)
    )


def test_the_domain_of_a_resumed_or_evaluated_run_may_have_been_moved(tmp_path):
    extended = ("env=domain_ext", "env.slot_error_prob=0", "domain=folder", "domain.path=old")
    save_config(composed("agent=dqn", *extended), tmp_path / "config.yaml")
    moved = resumed(tmp_path, "domain=folder", f"domain.path={tmp_path}")
    assert (moved.domain.path, moved.env.slot_error_prob) == (str(tmp_path), 0)

    config = evaluate.composed([f"policy={tmp_path}", "env.start=3", "domain.path=/moved"])
    assert (config.env.name, config.env.start, config.env.slot_error_prob) == ("domain_ext", 3, 0)
    assert config.domain.path == "/moved"
    chosen = evaluate.composed([f"policy={tmp_path}", "env=full"])
    assert (chosen.env.name, chosen.domain.name) == ("full", "folder")


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_runs_of_one_second_get_separate_folders(tmp_path):
    for _ in range(2):
        prepared("agent=dqn")
    assert len(list(tmp_path.glob("runs/*/*"))) == 2


def test_a_resumed_run_goes_on_in_its_folder_with_hydras_record_as_it_was(tmp_path):
    folder = tmp_path / "it's a run"
    folder.mkdir()
    save_config(composed("agent=dqn"), folder / "config.yaml")
    quoted = str(folder).replace("'", "\\'")  # for Hydra's grammar
    config, hydra = prepared(f"resume='{quoted}'")
    assert (config.agent.name, config.resume) == ("dqn", str(folder))
    assert (hydra.run.dir, hydra.output_subdir) == (str(folder), None)


def test_a_job_that_a_launcher_starts_again_goes_on_in_its_folder(tmp_path):
    config = composed("agent=bbqn", "agent.prior_std=.07", "agent.lr=1e-3")
    assert restarted_config(config, tmp_path).resume is None
    save_config(config, tmp_path / "config.yaml")
    assert restarted_config(config, tmp_path).resume == str(tmp_path)
    with pytest.raises(ConfigError, match="already holds another run"):
        restarted_config(composed("agent=bbqn", "seed=1"), tmp_path)


def test_an_evaluation_plays_with_the_users_that_it_names(capsys):
    users = "env.users={patience: [3, 3]}"
    evaluate.main(["policy=careful", "domain=hotel", "dialogues=60", "batch=60", users])
    assert json.loads(capsys.readouterr().out)["success_rate"] == 0
