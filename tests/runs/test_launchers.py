"""Sweeps as a person types them, on every engine that runs here."""

import forked
import pytest
from tiny import TINY, needs

PLUGINS = {
    "cores": None,
    "slurm_local": ("hydra_submitit_launcher", "slurm"),
    "ray_tasks": ("hydra_ray_launcher", "ray"),
}


@pytest.mark.slow
@pytest.mark.parametrize("launcher", PLUGINS)
def test_a_job_that_fails_leaves_the_others_alone_and_is_named(launcher, tmp_path):
    if PLUGINS[launcher]:
        package, extra = PLUGINS[launcher]
        needs(f"hydra_plugins.{package}", extra)
    few = ["hydra.launcher.ray.init.num_cpus=2"] if launcher == "ray_tasks" else []
    _, err = forked.python(
        forked.ROOT / "train.py",
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
    assert finished == ["1_dqn_epsilon_greedy_full_seed0", "3_bbqn_thompson_boltzmann_full_seed0"]
    assert f"2 of 4 runs in {tmp_path / 'sweep'} are finished" in err
    for failed in ("0_dqn_epsilon_greedy_full_seed0", "2_bbqn_thompson_boltzmann_full_seed0"):
        line = next(line for line in err.splitlines() if line.startswith(failed))
        assert "agent.lr=1e+30" in line  # as Hydra writes it
        assert "not finished: train.log in it says why" in line
        assert "is not finite in round 0" in (tmp_path / "sweep" / failed / "train.log").read_text()
