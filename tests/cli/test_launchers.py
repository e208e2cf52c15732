"""Sweeps and searches as a person types them, on every engine that can run on one machine."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from prepared import prepare

from bbq_torchrl.cli.resume import restarted_config, save_config
from bbq_torchrl.cli.store import compose, compose_raw, options, session
from bbq_torchrl.extras import install_command
from bbq_torchrl.options import ConfigError

ROOT = Path(__file__).resolve().parents[2]
TINY = (
    "protocol.rounds=2",
    "protocol.dialogues=4",
    "protocol.capacity=200",
    "protocol.eval_dialogues=6",
    "protocol.eval_batch=6",
    "protocol.checkpoint_every=1",
    "spike.dialogues=4",
    "agent.hidden=[8,8]",
)
PLUGINS = {
    "cores": None,
    "slurm_local": ("hydra_submitit_launcher", "slurm"),
    "ray_tasks": ("hydra_ray_launcher", "ray"),
}


def call(*arguments, cwd, code=0):
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *arguments]
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=1_800
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout, done.stderr


def needs(package, extra):
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"needs the extra {extra}: pip install -e '.[{extra}]'")


@pytest.mark.slow
@pytest.mark.parametrize("launcher", PLUGINS)
def test_a_job_that_fails_leaves_the_others_alone_and_is_named(launcher, tmp_path):
    if PLUGINS[launcher]:
        package, extra = PLUGINS[launcher]
        needs(f"hydra_plugins.{package}", extra)
    few = ["hydra.launcher.ray.init.num_cpus=2"] if launcher == "ray_tasks" else []
    _, err = call(
        str(ROOT / "train.py"),
        "--multirun",
        f"hydra/launcher={launcher}",
        "agent=dqn,bbqn",
        "agent.lr=1e30,.001",  # the first fails, so that there is something to lose
        *TINY,
        *few,
        "hydra.sweep.dir=sweep",
        cwd=tmp_path,
        code=1,
    )
    finished = sorted(file.parent.name for file in (tmp_path / "sweep").glob("*/result.json"))
    assert finished == ["1_dqn_epsilon_greedy_full_seed0", "3_bbqn_thompson_full_seed0"]
    assert "2 of 4 runs in sweep are finished" in err
    for failed in ("0_dqn_epsilon_greedy_full_seed0", "2_bbqn_thompson_full_seed0"):
        line = next(line for line in err.splitlines() if line.startswith(failed))
        assert "agent.lr=1e30" in line
        assert "not finished: train.log in it says why" in line
        assert "is not finite in round 0" in (tmp_path / "sweep" / failed / "train.log").read_text()


def test_a_sweep_runs_on_all_cores_with_a_thread_a_job_by_default():
    with session():
        composed = compose_raw([], with_hydra=True)
    assert composed.hydra.launcher._target_.endswith(".JoblibLauncher")
    assert composed.hydra.launcher.n_jobs == -1
    assert composed.threads == 1


def test_a_launcher_without_its_package_or_program_is_refused(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "")
    name = "slurm"
    message = re.escape(f"needs a package that is missing: {install_command('slurm')}")
    if importlib.util.find_spec("hydra_plugins.hydra_submitit_launcher") is not None:
        message = "hydra/launcher=slurm needs the program sbatch"
    with pytest.raises(ConfigError, match=message):
        prepare(["--multirun", f"hydra/launcher={name}"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("hydra/launcher=clouds", f"must be one of {', '.join(options('hydra/launcher'))}, got 'c"),
        ("hydra.launcher.n_job=2", "did you mean hydra.launcher.n_jobs?"),
        ("hydra.launcher.n_jobs=many", "hydra.launcher.n_jobs: Value 'many'"),
    ],
)
def test_a_wrong_launcher_is_refused_by_name(override, message, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as refused:
        prepare(["--multirun", override])
    assert message in str(refused.value)


def test_a_job_that_a_launcher_starts_again_goes_on_in_its_folder(tmp_path):
    config = compose(["agent=bbqn", "agent.prior_std=.07", "agent.lr=1e-3"])
    assert restarted_config(config, tmp_path).resume is None
    save_config(config, tmp_path / "config.yaml")
    assert restarted_config(config, tmp_path).resume == str(tmp_path)
    with pytest.raises(ConfigError, match="already holds another run"):
        restarted_config(compose(["agent=bbqn", "seed=1"]), tmp_path)
