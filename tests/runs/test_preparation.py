"""Checks of a run before its folder exists, and the choice of the folder."""

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


REFUSED = {
    "value": ("agent.lr=-1", "agent.lr"),
    "value of several replicas": ("replicas=4 agent.lr=[.1,.2,.3]", "agent.lr"),
    "combination": ("explore=noisy agent=bbqn", "explore"),
    "key added by a plus": ("+agent.lrr=1", "lrr"),
    "missing value": ("domain=folder", "domain.path"),
    "unresolved value": ("seed=${nothing}", "nothing"),
    "unresolved folder": ("hydra.run.dir=${nothing}", "hydra.run.dir"),
    "option": ("agent=foo", "agent"),
    "key": ("agent.lrr=1", "agent.lrr"),
    "type": ("seed=x", "seed"),
    "several values": ("seed=1,2", "seed"),
    "not key=value": ("seed", "seed"),
    "experiment": ("+experiment=foo", "experiment"),
    "device": ("device=cuda:99", "device"),
    "policy": ("spike.policy=none", "spike.policy"),
    "sweep": ("+experiment=ablations/draws", "--multirun"),
    "resume": ("resume=nowhere", "nowhere"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_run_is_refused_by_key_and_leaves_no_folder(case, tmp_path):
    overrides, key = REFUSED[case]
    with pytest.raises(ConfigError, match=key):
        prepared(*overrides.split())
    assert not list(tmp_path.iterdir())


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
