"""Preparation of a command line before Hydra runs it: checks of sweeps, choice of folders."""

from __future__ import annotations

import sys
from unittest.mock import Mock

import pytest
from prepared import prepare

from bbq_torchrl.options import registry
from bbq_torchrl.runs import checks, train
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.resume import save_config
from bbq_torchrl.settings import ConfigError


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_sweep_may_be_over_lists():
    checked = []
    prepare(["--multirun", "replicas=2", "agent.lr=[.1,.2],[.3,.4]"], checked.append)
    assert [config.agent.lr for config in checked] == [[0.1, 0.2], [0.3, 0.4]]


def test_the_jobs_of_a_sweep_that_an_experiment_asks_for_are_checked(tmp_path, monkeypatch):
    monkeypatch.setenv(registry.FOLDER_VARIABLE, str(tmp_path / "own"))
    (tmp_path / "own" / "experiment").mkdir(parents=True)
    (tmp_path / "own" / "experiment" / "sweep.yaml").write_text(
        "# @package _global_\n"
        "hydra:\n  mode: MULTIRUN\n  sweeper:\n    params:\n      agent.lr: .1,.2,-1\n"
    )
    with pytest.raises(ConfigError, match=r"agent\.lr must be a number from .*, got -1"):
        prepare(["+experiment=sweep"])
    checked = []
    prepare(["+experiment=sweep", "agent.lr=.3,.4"], checked.append)
    assert [config.agent.lr for config in checked] == [0.3, 0.4]


def test_jobs_that_only_another_sweeper_knows_are_left_to_it():
    other = ["--multirun", "hydra.sweeper._target_=some.OtherSweeper", "agent.lr=interval(.1,.2)"]
    assert prepare(other, fail).jobs == 0
    with pytest.raises(ConfigError, match="BasicSweeper does not support"):
        prepare(["--multirun", "agent.lr=interval(.1,.2)"], fail)


def test_a_single_run_is_checked_once_and_trains_with_what_the_check_has_loaded(
    tmp_path, monkeypatch
):
    domain, run = Mock(), Mock(return_value=Mock(success_rate=0.0))
    check = Mock(side_effect=lambda config: checks.Checked(config, domain, "rule"))
    monkeypatch.setattr(checks, "check", check)
    monkeypatch.setattr(train, "run", run)
    monkeypatch.setattr(sys, "argv", ["train.py", "agent=dqn", f"hydra.run.dir={tmp_path / 'it'}"])
    train.main()
    (config,) = check.call_args.args
    run.assert_called_once_with(config, tmp_path / "it", domain=domain, spiking="rule")
    assert run.call_args.args[0] is config
    assert "agent=dqn" in (tmp_path / "it" / ".hydra" / "overrides.yaml").read_text()


@pytest.mark.parametrize("command", [["agent=dqn"], ["--multirun", "agent=bbqn,dqn"]])
def test_two_runs_of_one_second_get_folders_of_their_own(tmp_path, command):
    for _ in range(3):
        prepare(command)
    assert len(list(tmp_path.glob("runs/*/*"))) == 3


@pytest.mark.parametrize(
    "command", [["--help"], ["--cfg", "job", "agent=dqn"], ["--info"], ["--hydra-help"]]
)
def test_what_only_shows_something_is_left_to_hydra(tmp_path, command):
    assert prepare(command, fail) is None
    assert not list(tmp_path.iterdir())


def fail(config):
    raise ValueError("nothing was to be checked")


def test_a_run_that_fails_its_check_leaves_no_folder(tmp_path):
    with pytest.raises(ValueError, match="nothing was to be checked"):
        prepare(["agent=dqn"], fail)
    assert not list(tmp_path.iterdir())


def test_a_resumed_run_goes_on_in_its_folder_with_hydras_record_as_it_was(tmp_path):
    folder = tmp_path / "it's a run"
    folder.mkdir()
    save_config(compose(["agent=dqn"]), folder / "config.yaml")
    checked = []
    # Quoted as the shell passes it to Hydra's grammar.
    quoted = str(folder).replace("'", "\\'")
    hydra = prepare([f"resume='{quoted}'"], checked.append).composed.hydra
    assert checked[0].agent.name == "dqn"
    assert (hydra.run.dir, hydra.output_subdir) == (str(folder), None)


def test_a_sweep_gets_the_folder_that_it_was_given_or_is_refused(tmp_path):
    folder = tmp_path / "new" / "sweep"
    arguments = ["--multirun", "seed=1,2", f"hydra.sweep.dir={folder}"]
    assert prepare(arguments).folder == folder
    assert folder.is_dir()
    with pytest.raises(ConfigError, match=f"or that of a sweep to continue, got {folder}"):
        prepare(arguments)
    (folder / "multirun.yaml").touch()
    job = folder / "1_bbqn_thompson_boltzmann_full_seed2"
    job.mkdir()
    save_config(compose(["seed=2"]), job / "config.yaml")
    assert prepare(arguments).folder == folder
    with pytest.raises(ConfigError, match=f"{job} already holds another run"):
        prepare([*arguments, "agent.lr=.5"])
