"""A saved configuration is read back, and a run goes on with it."""

from __future__ import annotations

import pytest
import yaml

from bbq_torchrl.cli.resume import load_config, resumed_config, save_config
from bbq_torchrl.cli.store import compose
from bbq_torchrl.options import ConfigError


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["agent=dqn", "env=domain_ext", "seed=3"],
        ["protocol=quick", "spike=none"],
        ["agent=bootstrap", "intrinsic=vime"],
    ],
)
def test_a_saved_configuration_is_read_back_as_it_was(tmp_path, command):
    config = compose(command)
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


@pytest.fixture(scope="module")
def five_rounds():
    return compose(["agent=dqn", "protocol.rounds=5"])


class TestResume:
    @pytest.fixture
    def folder(self, five_rounds, tmp_path):
        save_config(five_rounds, tmp_path / "config.yaml")
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

    def test_may_repeat_what_the_run_has_anyway(self, folder):
        assert self.resume(folder, "agent=dqn", "seed=0").agent.name == "dqn"

    @pytest.mark.parametrize(
        "override",
        [
            "agent=bbqn",
            "seed=1",
            "protocol.batch_size=8",
            "+experiment=quick",
            "hydra.run.dir=elsewhere",
        ],
    )
    def test_refuses_what_contradicts_the_run(self, folder, override):
        with pytest.raises(ConfigError, match="contradicts the run"):
            self.resume(folder, override)

    def test_refuses_fewer_rounds(self, folder):
        with pytest.raises(ConfigError, match=r"protocol\.rounds must be at least 5"):
            self.resume(folder, "protocol.rounds=4")

    def test_says_that_a_run_is_finished(self, folder):
        (folder / "result.json").write_text('{"rounds": 5}')
        (folder / "curve.png").touch()
        with pytest.raises(ConfigError, match="is finished"):
            self.resume(folder)

    def test_extends_a_finished_run(self, folder):
        (folder / "result.json").write_text('{"rounds": 5}')
        (folder / "curve.png").touch()
        assert self.resume(folder, "protocol.rounds=6").protocol.rounds == 6

    def test_refuses_a_folder_that_is_no_run_folder(self, tmp_path):
        with pytest.raises(ConfigError, match=r"is not a run folder: it has no config\.yaml"):
            self.resume(tmp_path)
        with pytest.raises(ConfigError, match="is not a run folder: there is no such folder"):
            self.resume(tmp_path / "nowhere")

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("agent: [", "is not a YAML file of a run"),
            ("- 1", "must hold a mapping of groups, got a list"),
            ("seed: 1", "agent must be given"),
            ("agent:\n  name: nope", "agent must be one of bbqn, bootstrap, dqn, got 'nope'"),
        ],
    )
    def test_refuses_a_folder_whose_configuration_is_damaged(self, folder, text, message):
        (folder / "config.yaml").write_text(text)
        with pytest.raises(ConfigError, match=message):
            self.resume(folder)
