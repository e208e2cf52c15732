"""The learning of every agent as users run it: a trainer's own, on a full replay buffer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer
from bbq_torchrl.envs import scripted_policy
from bbq_torchrl.trainers import play
from bbq_torchrl.trainers.collect import rows_per_replica

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bbq_torchrl.trainers import RoundTrainer
    from benchmarks.parts.timing import Timer

AGENTS: dict[str, tuple[str, ...]] = {
    "dqn": ("+experiment=agents/dqn",),
    "dqn without dropout": ("+experiment=agents/dqn", "agent.dropout=0"),
    "double dqn": ("+experiment=baselines/double_dqn",),
    "noisy dqn": ("+experiment=baselines/noisy_dqn",),
    "bootstrap, 10 heads": ("+experiment=agents/dqn_bootstrap",),
    "bbqn-map": ("+experiment=agents/bbqn_map",),
    "bbqn-mc": ("+experiment=agents/bbqn_mc",),
    "bbqn-mc, shared noise": ("+experiment=agents/bbqn_mc", "agent.target_noise=shared"),
    "dqn-vime-map": ("+experiment=agents/dqn_vime_map",),
    "dqn-vime-mc": ("+experiment=agents/dqn_vime_mc",),
    "bbqn-vime-map": ("+experiment=agents/bbqn_vime_map",),
    "bbqn-vime-mc": ("+experiment=agents/bbqn_vime_mc",),
}
"""Name -> its overrides. DQN with Boltzmann exploration learns as DQN does."""

TINY_CAPACITY = 64
TINY_OVERRIDES = ("protocol.dialogues=6",)
"""A buffer and a round so small that they only test the benchmarks."""


def full_trainer(
    overrides: Sequence[str], folder: Path, *, replicas: int, capacity: int
) -> RoundTrainer:
    """Returns a trainer whose buffers are full of dialogues of a random policy, ready to train."""
    chosen = [*overrides, f"replicas={replicas}", f"protocol.capacity={capacity}", "spike=none"]
    trainer, _ = build_trainer(compose(chosen), folder)
    trainer.progress = False
    random = scripted_policy("random", trainer.env)
    while min(trainer.replay.lengths) < capacity:
        trainer.replay.extend(rows_per_replica(play(trainer.env, random), trainer.replay.keys))
    trainer.begin()
    return trainer


class Learner:
    """One agent in a trainer of its own, and what of its training is timed.

    Args:
        overrides: of the configuration.
        folder: for the trainer's files.
        timer: the clock.
        replicas: networks trained side by side.
        capacity: transitions in the buffer of each, which is full.
        freezes: target freezes of a learning phase, of two epochs each.
    """

    def __init__(
        self,
        overrides: Sequence[str],
        folder: Path,
        timer: Timer,
        *,
        replicas: int = 1,
        capacity: int = 10_000,
        freezes: int = 1,
    ) -> None:
        chosen = [*overrides, f"protocol.freezes={freezes}"]
        self.trainer = full_trainer(chosen, folder, replicas=replicas, capacity=capacity)
        self.timer = timer
        self._round = 0
        env = self.trainer.env
        rollout = play(env, scripted_policy("random", env))
        self._new_rows = rows_per_replica(rollout, self.trainer.replay.keys)

    def learn(self) -> float:
        """Learns as in a round, all that comes with it included: freezing, targets, sampling.

        Returns:
            seconds of an update and replica.
        """
        started = self.timer.now()
        updates = self._learn()
        return (self.timer.now() - started) / updates

    def store_and_learn(self) -> float:
        """The same with the storing of a round's new transitions, such as the bonus of VIME."""
        started = self.timer.now()
        self.trainer.replay.extend(self._new_rows)
        updates = self._learn()
        return (self.timer.now() - started) / updates

    def _learn(self) -> int:
        self._round += 1
        self.trainer.learner.learn(self._round)
        return sum(self.trainer.learner.updates)
