"""The learning of every agent as users run it: by a trainer, on a full replay buffer."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from bbq_torchrl.envs import scripted_policy
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer
from bbq_torchrl.trainers import rollout
from bbq_torchrl.trainers.collect import rows_per_replica
from benchmarks.parts.timing import cpu_seconds

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bbq_torchrl.trainers import RoundTrainer
    from benchmarks.parts.timing import Block

AGENTS: dict[str, tuple[str, ...]] = {
    "dqn": ("+experiment=agents/dqn",),
    "double dqn": ("+experiment=agents/double_dqn",),
    "noisy dqn": ("+experiment=agents/noisy_dqn",),
    "bootstrap, 10 heads": ("+experiment=agents/dqn_bootstrap",),
    "bbqn-map": ("+experiment=agents/bbqn_map",),
    "bbqn-mc": ("+experiment=agents/bbqn_mc",),
    "bbqn-mc, shared noise": ("+experiment=agents/bbqn_mc", "agent.target_noise=shared"),
    "dqn-vime-map": ("+experiment=agents/dqn_vime_map",),
    "dqn-vime-mc": ("+experiment=agents/dqn_vime_mc",),
    "bbqn-vime-map": ("+experiment=agents/bbqn_vime_map",),
    "bbqn-vime-mc": ("+experiment=agents/bbqn_vime_mc",),
}
"""Name -> overrides. DQN with Boltzmann exploration learns like DQN."""


def full_trainer(
    overrides: Sequence[str], folder: Path, *, replicas: int, capacity: int
) -> RoundTrainer:
    """Returns a trainer, ready to train, with buffers full of a random policy's dialogues."""
    chosen = [*overrides, f"replicas={replicas}", f"protocol.capacity={capacity}", "spike=none"]
    trainer, _ = build_trainer(compose(chosen), folder)
    random = scripted_policy("random", trainer.env)
    while min(trainer.replay.lengths) < capacity:
        trainer.replay.extend(rows_per_replica(rollout(trainer.env, random), trainer.replay.keys))
    trainer.begin()
    return trainer


def learning_block(
    overrides: Sequence[str],
    folder: Path,
    *,
    replicas: int = 1,
    capacity: int = 10_000,
    freezes: int = 1,
    stores: bool = False,
) -> Block:
    """Returns a block that learns as in a round: freezing, targets, sampling. Learns once before.

    Its unit is an update and replica, timed by the processor's clock.

    Args:
        overrides: of the configuration.
        folder: for the trainer's files.
        replicas: networks trained side by side.
        capacity: transitions in the buffer of each, which is full.
        freezes: target freezes of a learning phase, of two epochs each.
        stores: whether a round's new transitions are stored first, with the bonus of VIME, say.
    """
    chosen = [*overrides, f"protocol.freezes={freezes}"]
    trainer = full_trainer(chosen, folder, replicas=replicas, capacity=capacity)
    played = rollout(trainer.env, scripted_policy("random", trainer.env))
    new_rows = rows_per_replica(played, trainer.replay.keys)
    numbers = itertools.count(1)

    def learn() -> None:
        if stores:
            trainer.replay.extend(new_rows)
        trainer.learner.learn(next(numbers))

    def block() -> float:
        return cpu_seconds(learn) / sum(trainer.learner.sums.updates)

    block()
    return block
