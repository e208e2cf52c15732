"""A whole round of training on a full buffer: what is spent on what.

    OMP_NUM_THREADS=1 pytest benchmarks/bench_round.py --benchmark-enable --benchmark-only -s

50 dialogues a replica of the movie domain, then four epochs over 10,000 transitions in batches of
32 (1,252 updates), metrics written, a tenth of a checkpoint. Updates are loss, gradient and Adam;
playing is the simulator and the policy; all the rest is bookkeeping, which is to stay below a
tenth of the round: storing and checking transitions, shuffling, batching, metrics, files.
"""

from __future__ import annotations

import time
from collections import Counter
from typing import TYPE_CHECKING

import pytest
import torch
from torchrl.objectives import HardUpdate

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.modules import MLP, BayesMLP, Greedy, ThompsonSampling, q_network
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss
from bbq_torchrl.trainers import (
    ReplicaAdam,
    RoundSettings,
    RoundTrainer,
    keep_freed_memory,
    make_loggers,
    play,
)
from bbq_torchrl.trainers.collect import rows_per_replica

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from torchrl.modules import QValueActor

CAPACITY, ROUNDS, CHECKPOINT_EVERY = 10_000, 5, 10


class Stopwatch:
    """Adds up the seconds spent in functions that it replaces by timed ones."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()

    def watch(self, owner: object, name: str, what: str) -> None:
        function: Callable = getattr(owner, name)

        def timed(*args: object, **kwargs: object) -> object:
            started = time.perf_counter()
            result = function(*args, **kwargs)
            self.seconds[what] += time.perf_counter() - started
            return result

        setattr(owner, name, timed)


def make_trainer(agent: str, replicas: int, folder: Path) -> RoundTrainer:
    torch.manual_seed(0)
    env = DialogueEnv(movie_domain(), batch_size=(replicas, 50), seed=0)
    spec = env.action_spec_unbatched
    sizes, stack = (env.layout.size, spec.n), (replicas,)
    actor: QValueActor
    if agent == "bbqn":
        actor = q_network(BayesMLP(*sizes, stack=stack), spec)
        loss, policy = BBQNLoss(actor), ThompsonSampling(actor)
    else:
        actor = q_network(MLP(*sizes, stack=stack, dropout=0.5), spec)
        loss, policy = DropoutDQNLoss(actor), Greedy(actor)
    trainer = RoundTrainer(
        env,
        policy,
        loss,
        ReplicaReplay(CAPACITY, replicas=replicas),
        ReplicaAdam(loss.parameters(), replicas),
        HardUpdate(loss, value_network_update_interval=0),
        RoundSettings(rounds=100, checkpoint_every=CHECKPOINT_EVERY),
        folder,
        loggers=make_loggers(["csv"], folder),
        progress=False,
    )
    while min(trainer.replay.lengths) < CAPACITY:
        rollout = play(env, scripted_policy("random", env))
        trainer.replay.extend(rows_per_replica(rollout, trainer.replay.keys))
    return trainer


@pytest.mark.parametrize(("agent", "replicas"), [("dqn", 1), ("bbqn", 1), ("dqn", 5), ("bbqn", 5)])
def test_round(benchmark, tmp_path, monkeypatch, agent: str, replicas: int):
    torch.set_num_threads(1)
    keep_freed_memory()
    trainer = make_trainer(agent, replicas, tmp_path / "run")
    trainer.begin()
    trainer.train_round()
    started = time.perf_counter()
    trainer.checkpoints.save(0, {}, name="timed")
    checkpoint = (time.perf_counter() - started) / CHECKPOINT_EVERY

    watch = Stopwatch()
    watch.watch(trainer.env, "rollout", "playing")
    watch.watch(trainer.loss, "forward", "updates")
    watch.watch(trainer.optimiser, "zero_grad", "updates")
    watch.watch(trainer.optimiser, "step", "updates")
    monkeypatch.setattr(torch.Tensor, "backward", torch.Tensor.backward)  # put back afterwards
    watch.watch(torch.Tensor, "backward", "updates")
    watch.watch(trainer.replay, "_shuffled", "shuffling")
    rounds: list[dict[str, float]] = []

    def one_round() -> None:
        watch.seconds.clear()
        begun = time.perf_counter()
        trainer.train_round()
        rounds.append({"round": time.perf_counter() - begun + checkpoint, **watch.seconds})

    benchmark.pedantic(one_round, rounds=ROUNDS)

    best = min(rounds, key=lambda seconds: seconds["round"])
    bookkeeping = best["round"] - best["playing"] - best["updates"]
    benchmark.extra_info |= {
        "playing_ms": 1e3 * best["playing"],
        "updates_ms": 1e3 * best["updates"],
        "shuffling_ms": 1e3 * best["shuffling"],
        "bookkeeping_ms": 1e3 * bookkeeping,
        "bookkeeping_percent": 100 * bookkeeping / best["round"],
    }
    print(f"\n{agent}, {replicas} replicas:", benchmark.extra_info)
    assert all(length == CAPACITY for length in trainer.replay.lengths)
