"""The update loop of a round on one GPU: an update of 1, 5 and 50 replicas, plain and as a graph.

    pytest benchmarks/bench_gpu.py --benchmark-enable --benchmark-only -s

The unit is milliseconds an update of all replicas, shuffling and sampling included, over a freeze
and an epoch of 2,000 transitions a replica (63 updates); the host waits for the device once at the
end. A last table has the ratios to one replica, whose targets are 1.3 (5 replicas) and 4 (50).
Without a CUDA device nothing is measured; with ``--benchmark-disable`` the same code then runs once
on the CPU, where there are no graphs.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
import torch

from bbq_torchrl.build import build_trainer
from bbq_torchrl.config.store import compose
from bbq_torchrl.envs import scripted_policy
from bbq_torchrl.trainers import RoundTrainer, play
from bbq_torchrl.trainers.collect import rows_per_replica

if TYPE_CHECKING:
    from pathlib import Path

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
ROWS, ROUNDS = 2_000, 5
AGENTS = ("dqn", "dqn_bootstrap", "dqn_vime_map", "bbqn_map", "bbqn_mc", "bbqn_vime_mc")
REPLICAS = (1, 5, 50)

_best: dict[tuple[str, bool, int], float] = {}


@pytest.fixture(autouse=True, scope="module")
def _table():
    yield
    name = torch.cuda.get_device_name() if DEVICE == "cuda" else "CPU"
    print(f"\n\n{name}\n{'agent':>16} {'graph':>6} {'replicas':>9} {'ms':>9} {'times one':>10}")
    for (agent, graph, replicas), seconds in _best.items():
        one = _best.get((agent, graph, 1), float("nan"))
        print(f"{agent:>16} {graph!s:>6} {replicas:9} {1e3 * seconds:9.3f} {seconds / one:10.2f}")


def make_trainer(agent: str, replicas: int, folder: Path, graph: bool) -> RoundTrainer:
    config = compose(
        [
            f"+experiment=agents/{agent}",
            f"device={DEVICE}",
            f"replicas={replicas}",
            f"cuda_graph={graph}",
            f"protocol.capacity={ROWS}",
            "protocol.freezes=1",
            "protocol.epochs=1",
            "spike=none",
        ]
    )
    trainer, _ = build_trainer(config, folder)
    policy = scripted_policy("random", trainer.env)
    while min(trainer.replay.lengths) < ROWS:
        rollout = play(trainer.env, policy)
        trainer.replay.extend(rows_per_replica(rollout, trainer.replay.keys))
    return trainer


def _wait() -> None:
    if DEVICE == "cuda":
        torch.cuda.synchronize()


@pytest.mark.parametrize("replicas", REPLICAS)
@pytest.mark.parametrize("graph", [True, False] if DEVICE == "cuda" else [True])
@pytest.mark.parametrize("agent", AGENTS)
def test_update_loop(benchmark, tmp_path, agent: str, graph: bool, replicas: int):
    if DEVICE == "cpu" and benchmark.enabled:
        pytest.skip("needs a CUDA device")
    trainer = make_trainer(agent, replicas, tmp_path, graph)
    trainer._learn(0)  # warms up and captures
    seconds: list[float] = []

    def one_epoch() -> None:
        _wait()
        started = time.perf_counter()
        trainer._update_all(1)
        _wait()
        seconds.append((time.perf_counter() - started) / -(-ROWS // 32))

    benchmark.pedantic(one_epoch, rounds=ROUNDS)
    _best[agent, graph, replicas] = min(seconds)
    benchmark.extra_info["milliseconds_per_update"] = 1e3 * min(seconds)
