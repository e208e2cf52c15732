"""A whole round of training on a full buffer: what is spent on what.

    OMP_NUM_THREADS=1 pytest benchmarks/bench_round.py --benchmark-enable --benchmark-only

50 dialogues a replica of the movie domain, then four epochs over 10,000 transitions in batches of
32 (1,252 updates), metrics written, a tenth of a checkpoint. Updates are targets, loss, gradient
and Adam; playing is the simulator and the policy; bookkeeping is all the rest, which is to stay
below a twentieth of the round: storing and checking transitions, shuffling, batching, metrics,
files.
"""

from __future__ import annotations

from statistics import median

import pytest

from benchmarks.parts.accounts import RoundAccounts
from benchmarks.parts.learning import AGENTS, TINY_CAPACITY, TINY_OVERRIDES, full_trainer

ROUNDS, CAPACITY = 3, 10_000
CASES = [(agent, replicas) for replicas in (1, 5) for agent in ("dqn", "bbqn-map", "bbqn-mc")]


@pytest.mark.parametrize(("agent", "replicas"), CASES)
def test_round(benchmark, timer, tmp_path, agent, replicas):
    capacity = TINY_CAPACITY if benchmark.disabled else CAPACITY
    overrides = (*AGENTS[agent], *TINY_OVERRIDES) if benchmark.disabled else AGENTS[agent]
    trainer = full_trainer(overrides, tmp_path / "run", replicas=replicas, capacity=capacity)
    trainer.train_round()
    save = timer.time(lambda: trainer.checkpoints.save(0, {}, name="timed"))
    checkpoint = save / trainer.settings.checkpoint_every
    rounds = []
    accounts = RoundAccounts(trainer)
    benchmark.pedantic(lambda: rounds.append(accounts.round()), rounds=ROUNDS)
    accounts.restore()

    kinds = {name: median(row[name] for row in rounds) for name in rounds[0]}
    bookkeeping = kinds["bookkeeping"] + checkpoint
    benchmark.extra_info |= {
        "playing_ms": 1e3 * kinds["playing"],
        "updates_ms": 1e3 * kinds["updates"],
        "bookkeeping_ms": 1e3 * bookkeeping,
        "bookkeeping_percent": 100 * bookkeeping / (kinds["round"] + checkpoint),
    }
    assert all(length == capacity for length in trainer.replay.lengths)
