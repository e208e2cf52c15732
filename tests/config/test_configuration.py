"""What a command line stands for, and what is refused before anything runs."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from itertools import product

import pytest
import yaml

from bbq_torchrl.config import EXPLORATIONS, SCHEMAS, ConfigError, EvaluateConfig
from bbq_torchrl.config.command import prepare
from bbq_torchrl.config.resume import resumed_config
from bbq_torchrl.config.schema import Config
from bbq_torchrl.config.settings import walk
from bbq_torchrl.config.store import compose, conf_folder, load_config, options, save_config


@pytest.mark.parametrize(("group", "option"), [(g, o) for g in SCHEMAS for o in SCHEMAS[g]])
def test_every_key_of_every_option_says_what_it_means_and_allows(group, option):
    for key, item, _ in walk(SCHEMAS[group][option]()):
        if key != "name":
            assert item.metadata["meaning"], key
            assert item.metadata["allowed"].text, key


@pytest.mark.parametrize("group", SCHEMAS)
def test_the_yaml_files_of_a_group_are_the_options_of_its_schema(group):
    assert set(options(group)) == set(SCHEMAS[group])


@pytest.mark.parametrize(
    ("group", "option"), [(g, o) for g in SCHEMAS for o in SCHEMAS[g] if o not in ("none", "quick")]
)
def test_yaml_and_dataclass_name_the_same_keys_and_defaults(group, option):
    plain = yaml.safe_load((conf_folder() / group / f"{option}.yaml").read_text())
    defaults = SCHEMAS[group][option]()
    plain.pop("defaults")
    for key, value in plain.items():
        assert getattr(defaults, key) == value, key


@pytest.mark.parametrize(("agent", "explore"), list(product(EXPLORATIONS, options("explore"))))
def test_every_pair_is_composed_or_refused_by_name(agent, explore):
    command = [f"agent={agent}", f"explore={explore}"]
    if explore in EXPLORATIONS[agent]:
        config = compose(command)
        assert (config.agent.name, config.explore.name) == (agent, explore)
    else:
        with pytest.raises(ConfigError, match=f"agent={agent} .* explore={explore}.*must be one"):
            compose(command)


@pytest.mark.parametrize("agent", EXPLORATIONS)
def test_an_agent_brings_its_own_exploration(agent):
    assert compose([f"agent={agent}"]).explore.name == EXPLORATIONS[agent][0]


def test_rounds_follow_the_environment_unless_given():
    assert compose().protocol.rounds == 400
    assert compose(["env=domain_ext"]).protocol.rounds == 200
    assert compose(["env=domain_ext", "protocol.rounds=20"]).protocol.rounds == 20


REFUSED = {
    "agent=nope": "agent must be one of bbqn, dqn, got 'nope'",
    "explore=nope": "explore must be one of",
    "env=nope": "env must be one of domain_ext, full",
    "+experiment=nope": "experiment must be one of",
    "agent.priorstd=1": "did you mean agent.prior_std",
    "nope=1": "nope is not a key",
    "seed=abc": "seed must be an integer of at least 0, got 'abc'",
    "seed=-1": "seed must be an integer of at least 0, got -1",
    "agent.lr=abc": "agent.lr must be a positive number, got 'abc'",
    "agent.lr=0": "agent.lr must be a positive number, got 0",
    "agent.hidden=[]": "agent.hidden must be a list of integers",
    "agent.gamma=1.5": "agent.gamma must be a number between 0 and 1, got 1.5",
    "agent.prior_std=-1": "agent.prior_std must be a positive number or 'fan_in', got -1",
    "agent.prior_std=wide": "agent.prior_std must be a positive number or 'fan_in', got 'wide'",
    "agent.target=both": "agent.target must be one of map, mc, got 'both'",
    "replicas=0": "replicas must be an integer of at least 1, got 0",
    "replicas=1.5": "replicas must be an integer",
    "device=tpu": "device must be 'cpu', 'cuda' or 'cuda:<number>', got 'tpu'",
    "protocol.rounds=0": "protocol.rounds must be an integer of at least 1, got 0",
    "protocol.capacity=8": "protocol.capacity must be at least protocol.batch_size",
    "spike.dialogues=-1": "spike.dialogues must be an integer of at least 0, got -1",
    "spike.protect=maybe": "spike.protect must be true or false",
    "env.slot_error_prob=2": "env.slot_error_prob must be a number between 0 and 1",
    "env.slot_error_mode=foo": "env.slot_error_mode must be one of value, slot, delete, mixed",
    "env.max_turn=1": "env.max_turn must be an integer of at least 2, got 1",
    "domain=miulab": "domain.path must be given",
    "spike.drop_above=.5 spike.protect=false": "spike.drop_above cannot be combined",
    "env=domain_ext agent.kl=sampled": "agent.kl must be closed",
    "agent=dqn agent.prior_std=.1": "agent.prior_std is not a key",
}


@pytest.mark.parametrize("command", REFUSED)
def test_what_cannot_be_run_is_refused_in_one_sentence(command):
    with pytest.raises(ConfigError) as refused:
        compose(command.split())
    message = str(refused.value)
    assert REFUSED[command] in message
    assert "\n" not in message.strip()


def test_every_job_of_a_sweep_is_checked_before_the_first_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="agent=dqn cannot be combined"):
        prepare(["--multirun", "agent=bbqn,dqn", "explore=thompson"], lambda config: None)
    assert not list(tmp_path.iterdir())


def test_two_runs_of_one_second_get_folders_of_their_own(tmp_path):
    folder = tmp_path / "run"
    command = ["--multirun", f"hydra.sweep.dir={folder}", "agent=bbqn,dqn"]
    prepared = [prepare(command, lambda config: None)[-1] for _ in range(2)]
    assert len(set(prepared)) == 2
    assert len(list(tmp_path.iterdir())) == 2


def test_a_run_folder_is_not_used_twice(tmp_path):
    save_config(compose(), tmp_path / "config.yaml")
    with pytest.raises(ConfigError, match="already holds a run"):
        prepare([f"hydra.run.dir={tmp_path}"], lambda config: None)


@pytest.mark.parametrize(
    "command", [[], ["agent=dqn", "env=domain_ext", "seed=3"], ["protocol=quick", "spike=none"]]
)
def test_a_saved_configuration_is_read_back_as_it_was(tmp_path, command):
    config = compose(command)
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml") == config


class TestResume:
    @pytest.fixture
    def folder(self, tmp_path):
        save_config(compose(["agent=dqn", "protocol.rounds=5"]), tmp_path / "config.yaml")
        return tmp_path

    def resume(self, folder, *overrides):
        command = [f"resume={folder}", *overrides]
        return resumed_config(compose(command), command)

    def test_takes_the_configuration_of_the_folder(self, folder):
        config = self.resume(folder)
        assert (config.agent.name, config.explore.name) == ("dqn", "epsilon_greedy")
        assert config.protocol.rounds == 5

    def test_may_train_longer_and_log_elsewhere(self, folder):
        config = self.resume(folder, "protocol.rounds=9", "logger=tensorboard")
        assert config.protocol.rounds == 9
        assert config.logger.name == "tensorboard"

    @pytest.mark.parametrize("override", ["agent=bbqn", "seed=1", "protocol.batch_size=8"])
    def test_refuses_what_contradicts_the_run(self, folder, override):
        with pytest.raises(ConfigError, match="contradicts the run"):
            self.resume(folder, override)

    def test_refuses_fewer_rounds(self, folder):
        with pytest.raises(ConfigError, match=r"protocol\.rounds must be at least 5"):
            self.resume(folder, "protocol.rounds=4")

    def test_says_that_a_run_is_finished(self, folder):
        (folder / "result.json").write_text("{}")
        with pytest.raises(ConfigError, match="is finished"):
            self.resume(folder)

    def test_refuses_a_folder_that_is_no_run_folder(self, tmp_path):
        with pytest.raises(ConfigError, match="is not a run folder"):
            self.resume(tmp_path)


def test_evaluation_composes_from_the_same_groups():
    config = compose(["policy=rule", "env=domain_ext"], EvaluateConfig)
    assert is_dataclass(config.env)
    assert config.env.name == "domain_ext"
    shared = {item.name for item in fields(Config)} & {item.name for item in fields(EvaluateConfig)}
    assert {"env", "domain", "seed", "device"} <= shared
