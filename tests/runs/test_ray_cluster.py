"""A sweep on a Ray cluster of two nodes on this machine, one of which is killed."""

import importlib.util
import os
import subprocess
import sys
import time

import forked
import pytest
from tiny import TINY, rows

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("ray") is None,
        reason="needs the extra ray: pip install -e '.[ray]'",
    ),
]

JOBS = ("--multirun", "agent=dqn,bbqn", "seed=range(0,6)", *TINY, "hydra.sweep.dir=sweep")
MINUTES = 20


@pytest.fixture
def cluster(monkeypatch, tmp_path):
    """A head and a node, of a core each; Ray's token stays out of the home folder."""
    from ray.cluster_utils import Cluster

    for key, value in {**forked.environment(), "HOME": str(tmp_path)}.items():
        monkeypatch.setenv(key, value)
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    yield made
    made.shutdown()


def start(cluster, folder):
    given = ("hydra/launcher=ray_tasks", f"hydra.launcher.ray.init.address={cluster.address}")
    folder.mkdir()
    return subprocess.Popen(
        [sys.executable, str(forked.ROOT / "train.py"), *JOBS, *given],
        cwd=folder,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        env=os.environ,
    )


def wait_for_a_result(process, folder):
    end = time.monotonic() + 60 * MINUTES
    while not list(folder.glob("sweep/*/result.json")):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end
        time.sleep(0.1)


def test_a_sweep_survives_a_killed_node_with_the_results_of_one_process(cluster, tmp_path):
    node = cluster.add_node(num_cpus=1)
    process = start(cluster, tmp_path / "ray")
    wait_for_a_result(process, tmp_path / "ray")
    cluster.remove_node(node, allow_graceful=False)  # by SIGKILL
    _, err = process.communicate(timeout=60 * MINUTES)
    assert process.returncode == 0, err
    assert "12 of 12 runs in" in err
    (tmp_path / "one").mkdir()
    forked.python(forked.ROOT / "train.py", *JOBS, "hydra/launcher=basic", cwd=tmp_path / "one")
    alone = sorted((tmp_path / "one" / "sweep").glob("*/metrics.csv"))
    assert len(alone) == 12
    for file in alone:
        assert rows(tmp_path / "ray" / "sweep" / file.parent.name / file.name) == rows(file)
