"""The options of ``protocol=``: the length and the steps of training and evaluation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.settings import (
    BATCH,
    COUNT,
    NON_NEGATIVE_INTEGER,
    PROBABILITY,
    STEP_SIZE,
    ConfigError,
    integers,
    one_of,
    option,
    optional,
    other_default,
    setting,
)

STORED = integers(1, 10**6)  # transitions, or outcomes of dialogues, of a replica


@dataclass
class ProtocolOption(Option):
    """The length and the steps of an agent's training and evaluation."""

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

    def check(self) -> None:
        """Refuses settings that contradict each other."""
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


@register
@dataclass
class PaperProtocol(ProtocolOption):
    """The paper's protocol."""

    name: str = option("paper")


@register
@dataclass
class QuickProtocol(ProtocolOption):
    """A minute on one core: fewer rounds, larger batches, a smaller buffer; it learns to book."""

    name: str = option("quick")
    rounds: int = other_default(ProtocolOption, "rounds", 40)
    batch_size: int = other_default(ProtocolOption, "batch_size", 128)
    lr: float = other_default(ProtocolOption, "lr", 2e-3)
    epochs: int = other_default(ProtocolOption, "epochs", 3)
    capacity: int = other_default(ProtocolOption, "capacity", 5_000)
    eval_dialogues: int = other_default(ProtocolOption, "eval_dialogues", 2_000)
    eval_batch: int = other_default(ProtocolOption, "eval_batch", 2_000)
    eval_every_dialogues: int = other_default(ProtocolOption, "eval_every_dialogues", 150)
