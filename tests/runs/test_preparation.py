"""The choice of a run's folder; tests/adversary/test_bad_input.py has what is refused."""

import pytest
from prepared import prepared

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.folders import restarted_config, save_config
from bbq_torchrl.settings import ConfigError


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_runs_of_one_second_get_separate_folders(tmp_path):
    for _ in range(3):
        prepared("agent=dqn")
    assert len(list(tmp_path.glob("runs/*/*"))) == 3


def test_a_resumed_run_goes_on_in_its_folder_with_hydras_record_as_it_was(tmp_path):
    folder = tmp_path / "it's a run"
    folder.mkdir()
    save_config(compose(["agent=dqn"]), folder / "config.yaml")
    quoted = str(folder).replace("'", "\\'")  # for Hydra's grammar
    config, hydra = prepared(f"resume='{quoted}'")
    assert (config.agent.name, config.resume) == ("dqn", str(folder))
    assert (hydra.run.dir, hydra.output_subdir) == (str(folder), None)


def test_a_folder_with_a_run_is_not_used_again(tmp_path):
    save_config(compose(["agent=dqn"]), tmp_path / "config.yaml")
    with pytest.raises(ConfigError, match=f"resume={tmp_path}"):
        prepared(f"hydra.run.dir={tmp_path}")


def test_a_job_that_a_launcher_starts_again_goes_on_in_its_folder(tmp_path):
    config = compose(["agent=bbqn", "agent.prior_std=.07", "agent.lr=1e-3"])
    assert restarted_config(config, tmp_path).resume is None
    save_config(config, tmp_path / "config.yaml")
    assert restarted_config(config, tmp_path).resume == str(tmp_path)
    with pytest.raises(ConfigError, match="already holds another run"):
        restarted_config(compose(["agent=bbqn", "seed=1"]), tmp_path)
