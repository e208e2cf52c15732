"""Saved configurations: loading them, and resuming runs with them."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest
import yaml
from prepared import resumed

from bbq_torchrl.cli.evaluate import composed
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.resume import load_config, save_config
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import text
from bbq_torchrl.utils.text import sentence

SAVED_BY_0_1_0 = Path(__file__).parent.parent / "data" / "runs_of_0_1_0"


@pytest.mark.parametrize(
    "command",
    [
        "",
        "agent=dqn env=domain_ext seed=3",
        "protocol=quick spike=none agent=bootstrap intrinsic=vime",
    ],
)
def test_a_saved_configuration_is_read_back_as_it_was(tmp_path, command):
    config = compose(command.split())
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml") == config


def test_a_run_of_a_version_without_evaluation_and_intrinsic_rewards_has_none(tmp_path):
    file = tmp_path / "config.yaml"
    save_config(compose(["agent=dqn"]), file)
    saved = yaml.safe_load(file.read_text())
    del saved["protocol"]["eval_every"], saved["protocol"]["eval_every_dialogues"]
    del saved["intrinsic"], saved["protocol"]["keep_checkpoints"]
    file.write_text(yaml.safe_dump({**saved, "cuda_graph": False}))
    config = load_config(file)
    assert (config.protocol.eval_every, config.intrinsic.name) == (0, "none")


@pytest.mark.parametrize("agent", ["dqn", "boltzmann", "bootstrap"])
def test_what_0_1_0_saved_is_read_as_what_it_did(agent):
    config = load_config(SAVED_BY_0_1_0 / f"{agent}.yaml")
    assert (config.protocol.eval_every, config.intrinsic.name, config.replicas) == (0, "none", 1)
    if agent == "bootstrap":
        assert config.explore.per == "episode"
    else:  # over 100 rounds; the training had 2
        assert config.explore.anneal_fraction == 1


def test_a_run_without_a_spike_is_read_whose_version_named_the_rule_all_the_same(tmp_path):
    file = tmp_path / "config.yaml"
    save_config(compose(["spike=none"]), file)
    file.write_text(re.sub(r"(spike:\n(?:  .*\n)*?  policy:) null", r"\1 rule", file.read_text()))
    assert yaml.safe_load(file.read_text())["spike"]["policy"] == "rule"
    assert load_config(file).spike == compose(["spike=none"]).spike


def test_a_resumed_run_has_its_own_configuration_but_for_what_may_change(tmp_path):
    run = ["agent=dqn", "agent.gamma=[.8,.9]", "replicas=2", "threads=3", "protocol.rounds=5"]
    save_config(compose(run), tmp_path / "config.yaml")
    config = resumed(tmp_path, "agent=dqn", "seed=0", "threads=3")
    assert config == dataclasses.replace(compose(run), resume=str(tmp_path))
    changes = ["protocol.rounds=9", "protocol.keep_checkpoints=all", "logger=wandb", "device=cuda"]
    changed = resumed(tmp_path, *changes, "logger.project=mine")
    assert changed == dataclasses.replace(
        compose([*run, *changes, "logger.project=mine"]), resume=str(tmp_path)
    )


EXTENDED = ("env=domain_ext", "env.slot_error_prob=0", "domain=folder", "domain.path=old")


def test_keys_beside_resume_are_read_on_the_values_of_the_run(tmp_path):
    save_config(compose(["agent=dqn", *EXTENDED]), tmp_path / "config.yaml")
    assert resumed(tmp_path, "protocol.rounds=${env.paper_rounds}").protocol.rounds == 200
    moved = resumed(tmp_path, f"domain.path={tmp_path}", "env.slot_error_prob=0")
    assert (moved.domain.path, moved.env.slot_error_prob) == (str(tmp_path), 0)


def test_keys_beside_the_policy_of_a_run_are_read_on_its_values(tmp_path):
    save_config(compose(["agent=dqn", *EXTENDED]), tmp_path / "config.yaml")
    config = composed([f"policy={tmp_path}", "env.start=3", "domain.path=/moved"])
    assert (config.env.name, config.env.start, config.env.slot_error_prob) == ("domain_ext", 3, 0)
    assert config.domain.path == "/moved"
    chosen = composed([f"policy={tmp_path}", "env=full"])
    assert (chosen.env.name, chosen.domain.name) == ("full", "folder")


def test_a_run_is_not_extended_to_an_evaluation_longer_than_its_training(tmp_path):
    evaluations = ["protocol.eval_every=3", "protocol.eval_every_dialogues=100000"]
    tiny = ["protocol.dialogues=4", "spike.dialogues=4", "protocol.rounds=2"]
    save_config(compose(["agent=dqn", *tiny, *evaluations]), tmp_path / "config.yaml")
    with pytest.raises(ConfigError, match=r"protocol.eval_every must be 0 or at least \d+ with"):
        resumed(tmp_path, "protocol.rounds=3")


def test_what_an_environment_variable_holds_is_in_no_error(monkeypatch):
    monkeypatch.setattr(text, "_concealed", {})
    monkeypatch.setenv("KEY", "hunter 'two'\n" + "x" * 300)
    for value in ("${oc.env:KEY}", "'${oc.env:\"KEY\"}'", "'a${oc.env:KEY,none}b'"):
        with pytest.raises(ConfigError) as caught:
            compose([f"agent.kl={value}"])
        for said in (str(caught.value), sentence(caught.value)):
            assert "hunter" not in said
            assert "xxx" not in said
            assert "${oc.env:" in said


def test_a_variable_of_few_letters_changes_no_other_word(monkeypatch):
    monkeypatch.setattr(text, "_concealed", {})
    monkeypatch.setenv("KEY", "one")
    with pytest.raises(ConfigError, match="must be one of closed, sampled, got 'one'"):
        compose(["agent.kl=${oc.env:KEY}"])
