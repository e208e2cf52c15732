"""The options of ``protocol=``: how long and in which steps an agent trains and is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option
from bbq_torchrl.options.settings import (
    BATCH,
    COUNT,
    NON_NEGATIVE_INTEGER,
    PROBABILITY,
    STEP_SIZE,
    ConfigError,
    integers,
    one_of,
    optional,
    setting,
)

if TYPE_CHECKING:
    from bbq_torchrl.options.root import Config


__all__ = ["ProtocolOption"]

STORED = integers(1, 10**6)  # transitions, or outcomes of dialogues, of a replica

FIXED_ROWS = 200
"""What a step of dialogues side by side, or an update, costs before its rows, in rows.

Measured on a CPU core for BBQN and DQN, batches of 32 and 128, 50 to 1,000 dialogues, one and five
replicas: with this, the time of a step or update per row is within a factor of two of its mean.
"""


@dataclass
class ProtocolOption(Option):
    """How long and in which steps an agent trains and is measured."""

    group: ClassVar[str] = "protocol"

    rounds: int = setting("${env.paper_rounds}", COUNT, "rounds of training")
    dialogues: int = setting(50, BATCH, "dialogues of a round and replica")
    batch_size: int = setting(32, BATCH, "transitions of an update")
    lr: float = setting(1e-3, STEP_SIZE, "step size of Adam, for batches of this size")
    lr_final: float = setting(
        1.0, PROBABILITY, "share of every step size left in the last round; 1: it stays"
    )
    lr_decay_from: float = setting(
        0.5, PROBABILITY, "share of the rounds after which step sizes fall, linearly, to lr_final"
    )
    freezes: int = setting(2, COUNT, "target freezes of a round")
    epochs: int = setting(2, COUNT, "passes over the buffer after each freeze")
    updates_per_round: int | None = setting(
        None,
        optional(COUNT, "as many as the epochs have"),
        "updates of every round and replica, in place of the epochs",
    )
    capacity: int = setting(10_000, STORED, "transitions a replica's buffer holds")
    eval_dialogues: int = setting(10_000, STORED, "dialogues of the final evaluation of a replica")
    eval_batch: int = setting(2_500, BATCH, "evaluation dialogues of all replicas side by side")
    eval_every: int = setting(
        5, NON_NEGATIVE_INTEGER, "rounds between two evaluations while training; 0: never"
    )
    eval_every_dialogues: int = setting(
        400, STORED, "dialogues of an evaluation while training, of a replica"
    )
    checkpoint_every: int = setting(10, COUNT, "rounds between two checkpoints")
    keep_checkpoints: str = setting(
        "weights",
        one_of("all", "last", "weights"),
        "every checkpoint, the last two, or after the end nothing but the weights",
    )

    def lr_share(self, round_number: int) -> float:
        """Returns the share of every step size that a round, counted from 0, learns with.

        Examples:
            >>> protocol = ProtocolOption(rounds=8, lr_final=0.2, lr_decay_from=0.5)
            >>> [round(protocol.lr_share(number), 2) for number in range(8)]
            [1.0, 1.0, 1.0, 1.0, 0.8, 0.6, 0.4, 0.2]
        """
        start = self.lr_decay_from * self.rounds
        since = round_number + 1 - start
        return 1.0 if since <= 0 else 1.0 - (1.0 - self.lr_final) * since / (self.rounds - start)

    def places(self, dialogues: int, replicas: int) -> int:
        """Returns how many of a replica's evaluation dialogues are played side by side.

        A rollout holds every turn's observations: of 12,500 dialogues they fill two gigabytes.
        """
        return min(dialogues, max(1, self.eval_batch // replicas))

    def check(self, config: Config) -> None:
        """Refuses settings that contradict each other, and long evaluations."""
        if self.capacity < self.batch_size:
            raise ConfigError(
                f"protocol.capacity must be at least protocol.batch_size ({self.batch_size}), "
                f"got {self.capacity}"
            )
        if self.updates_per_round is not None:
            own = f"with protocol.updates_per_round={self.updates_per_round}"
            if self.epochs != type(self).epochs:
                raise ConfigError(
                    f"protocol.epochs must be {type(self).epochs} {own}, which takes its place, "
                    f"got {self.epochs}"
                )
            if self.updates_per_round < self.freezes:
                raise ConfigError(
                    f"protocol.updates_per_round must be at least protocol.freezes "
                    f"({self.freezes}), got {self.updates_per_round}"
                )
        if self.lr_final == 1 and self.lr_decay_from != type(self).lr_decay_from:
            raise ConfigError(
                f"protocol.lr_decay_from must be {type(self).lr_decay_from} with "
                f"protocol.lr_final={self.lr_final}, where step sizes stay, got "
                f"{self.lr_decay_from}"
            )
        if self.lr_final != 1 and self.lr_decay_from == 1:
            raise ConfigError(
                f"protocol.lr_decay_from must be below 1 with protocol.lr_final={self.lr_final}: "
                "no round would be left in which step sizes fall"
            )
        _check_evaluation(config)


def _check_evaluation(config: Config) -> None:
    """Refuses evaluations that would take longer than the rounds between them.

    Both sides are counted, not timed: every step of the dialogues that are played side by side, and
    every update, counts 200 plus its rows (dialogues or transitions, of all replicas). Dialogues
    are taken to be as long as they may be, and the buffer as full as it gets.

    Raises:
        ConfigError: with the numbers, and what would do.
    """
    protocol, replicas = config.protocol, config.replicas
    if not protocol.eval_every or protocol.eval_every > protocol.rounds:
        return
    turns = config.env.steps()
    dialogues = protocol.eval_every_dialogues
    places = protocol.places(dialogues, replicas)
    evaluation = math.ceil(dialogues / places) * turns * (FIXED_ROWS + replicas * places)
    stored = (config.spike.dialogues + protocol.rounds * protocol.dialogues) * turns
    updates = protocol.updates_per_round
    if updates is None:
        batches = math.ceil(min(protocol.capacity, stored) / protocol.batch_size)
        updates = protocol.freezes * protocol.epochs * batches
    a_round = turns * (FIXED_ROWS + replicas * protocol.dialogues)
    a_round += updates * (FIXED_ROWS + replicas * protocol.batch_size)
    if evaluation <= protocol.eval_every * a_round:
        return
    raise ConfigError(
        f"protocol.eval_every must be 0 or at least {math.ceil(evaluation / a_round)} with "
        f"protocol.eval_every_dialogues={dialogues}, got {protocol.eval_every}: an evaluation "
        f"would take longer than the training between two ({evaluation:,} against "
        f"{protocol.eval_every * a_round:,}, where a step or an update counts {FIXED_ROWS} and its "
        "rows)"
    )
