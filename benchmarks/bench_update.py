"""The update of every agent: 268-256-256-39 networks, batches of 32.

    OMP_NUM_THREADS=1 pytest benchmarks/bench_update.py --benchmark-enable --benchmark-only

A round of the benchmark is the learning after one freeze, as the trainer does it: targets, two
epochs over a full buffer, shuffling, batching, loss, gradient, Adam. Buffers hold 10,000
transitions of one network and 3,200 of each of ten. Milliseconds are of one update of one network;
`ready` is the same update of a batch that lies ready: loss, gradient, Adam alone. `times_bare` is
the median of what the learning takes beside the yardstick, a DQN update written by hand (three
`addmm` for each network, fused Adam, no TensorDict, a ready batch), which runs before each round.
Boltzmann exploration learns as DQN does.
"""

from __future__ import annotations

import pytest

from benchmarks.parts.learning import AGENTS, TINY_CAPACITY, TINY_OVERRIDES, Learner
from benchmarks.parts.timing import compared
from benchmarks.parts.yardstick import bare_block, bare_update

ROUNDS, BARE_UPDATES, READY_UPDATES = 5, 300, 50
CAPACITY = {1: 10_000, 10: 3_200}


def test_bare_dqn_update(benchmark):
    benchmark.pedantic(bare_update(), rounds=20, iterations=25, warmup_rounds=3)


@pytest.mark.parametrize("replicas", CAPACITY)
@pytest.mark.parametrize("agent", AGENTS)
def test_update(benchmark, timer, tmp_path, agent, replicas):
    is_measured = not benchmark.disabled
    capacity = CAPACITY[replicas] if is_measured else TINY_CAPACITY
    overrides = AGENTS[agent] if is_measured else (*AGENTS[agent], *TINY_OVERRIDES)
    learner = Learner(overrides, tmp_path / "run", timer, replicas=replicas, capacity=capacity)
    bare = bare_block(timer, BARE_UPDATES if is_measured else 1)
    learner.learn()
    bases, learned = [], []
    benchmark.pedantic(
        lambda: learned.append(learner.learn()),
        setup=lambda: bases.append(bare()),
        rounds=ROUNDS,
    )
    ready = learner.update_ready_batch(READY_UPDATES if is_measured else 1)
    compares = compared(bases, learned)
    benchmark.extra_info |= {
        "buffer": capacity,
        "ms_per_update": 1e3 * compares.seconds,
        "ready_ms": 1e3 * ready,
        "times_bare": compares.ratio,
    }
    assert min(learned) > 0
