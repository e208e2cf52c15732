"""Sweeps as a person types them, on every engine that runs here, and on a cluster of Ray."""

import forked
import pytest
from tiny import TINY, needs, rows

from bbq_torchrl.runs.compose import compose_raw, session

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


def test_a_sweep_runs_on_all_cores_with_a_thread_a_job_by_default():
    with session():
        composed = compose_raw([])
    assert composed.hydra.launcher._target_.endswith(".JoblibLauncher")
    assert composed.hydra.launcher.n_jobs == -1
    assert composed.threads == 1


JOBS = ("--multirun", "agent=dqn,bbqn", "seed=range(0,6)", *TINY, "hydra.sweep.dir=sweep")


@pytest.fixture
def cluster(monkeypatch, tmp_path):
    """A head and a node, of a core each; Ray's token stays out of the home folder."""
    needs("ray", "ray")
    from ray.cluster_utils import Cluster

    for key, value in {**forked.environment(), "HOME": str(tmp_path)}.items():
        monkeypatch.setenv(key, value)
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    yield made
    made.shutdown()


@pytest.mark.slow
def test_a_sweep_survives_a_killed_node_with_the_results_of_one_process(cluster, tmp_path):
    node = cluster.add_node(num_cpus=1)
    given = ("hydra/launcher=ray_tasks", f"hydra.launcher.ray.init.address={cluster.address}")
    (tmp_path / "ray").mkdir()
    process = forked.process(*JOBS, *given, cwd=tmp_path / "ray")
    forked.wait_until(process, lambda: list(tmp_path.glob("ray/sweep/*/result.json")))
    cluster.remove_node(node, allow_graceful=False)  # by SIGKILL
    _, err = process.communicate(timeout=forked.SECONDS)
    assert process.returncode == 0, err
    assert "12 of 12 runs in" in err
    (tmp_path / "one").mkdir()
    forked.python(forked.ROOT / "train.py", *JOBS, "hydra/launcher=basic", cwd=tmp_path / "one")
    alone = sorted((tmp_path / "one" / "sweep").glob("*/metrics.csv"))
    assert len(alone) == 12
    for file in alone:
        assert rows(tmp_path / "ray" / "sweep" / file.parent.name / file.name) == rows(file)
