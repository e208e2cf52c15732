"""The options of ``protocol=``: the schedule of training and evaluation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.settings import (
    BATCH,
    BELOW_ONE,
    COUNT,
    NON_NEGATIVE_INTEGER,
    PROBABILITY,
    STEP_SIZE,
    ConfigError,
    integers,
    one_of,
    option,
    other_default,
    setting,
)

STORED = integers(1, 10**6)  # transitions, or outcomes of dialogues, of a replica


@dataclass
class ProtocolOption(Option):
    """The schedule of an agent's training and evaluation."""

    group: ClassVar[str] = "protocol"

    rounds: int = setting("${env.paper_rounds}", COUNT, "rounds of training")
    dialogues: int = setting(50, BATCH, "dialogues of a round and replica")
    batch_size: int = setting(32, BATCH, "transitions of an update")
    lr: float = setting(1e-3, STEP_SIZE, "learning rate of Adam")
    lr_final: float = setting(1.0, PROBABILITY, "factor on learning rates in the last round")
    lr_decay_from: float = setting(0.5, BELOW_ONE, "share of the rounds before learning rates fall")
    freezes: int = setting(2, COUNT, "target freezes of a round")
    epochs: int = setting(2, COUNT, "passes over the buffer after each freeze")
    capacity: int = setting(10_000, STORED, "capacity of a replica's buffer in transitions")
    eval_dialogues: int = setting(10_000, STORED, "dialogues of a replica's final evaluation")
    eval_batch: int = setting(2_500, BATCH, "parallel evaluation dialogues of all replicas")
    eval_every: int = setting(5, NON_NEGATIVE_INTEGER, "rounds between evaluations; 0: never")
    eval_every_dialogues: int = setting(400, STORED, "dialogues of a replica in such evaluations")
    checkpoint_every: int = setting(10, COUNT, "rounds between two checkpoints")
    keep_checkpoints: str = setting(
        "weights", one_of("all", "last", "weights"), "all, the last two, or at the end the weights"
    )

    def lr_share(self, round_number: int) -> float:
        """Returns the factor on learning rates in a round, counted from 0.

        Examples:
            >>> protocol = ProtocolOption(rounds=8, lr_final=0.2, lr_decay_from=0.5)
            >>> [round(protocol.lr_share(number), 2) for number in range(8)]
            [1.0, 1.0, 1.0, 1.0, 0.8, 0.6, 0.4, 0.2]
        """
        start = self.lr_decay_from * self.rounds
        since = round_number + 1 - start
        return 1.0 if since <= 0 else 1.0 - (1.0 - self.lr_final) * since / (self.rounds - start)

    def parallel_dialogues(self, dialogues: int, replicas: int) -> int:
        """Returns the number of a replica's parallel evaluation dialogues.

        A rollout contains the observations of every turn; of 12,500 dialogues they take 2 GB.
        """
        return min(dialogues, max(1, self.eval_batch // replicas))

    def check(self) -> None:
        """Refuses a buffer smaller than a batch."""
        if self.capacity < self.batch_size:
            raise ConfigError(
                f"protocol.capacity must be at least protocol.batch_size ({self.batch_size}), "
                f"got {self.capacity}"
            )


@register
@dataclass
class PaperProtocol(ProtocolOption):
    """The paper's protocol."""

    name: str = option("paper")


@register
@dataclass
class QuickProtocol(ProtocolOption):
    """A minute on one core: fewer rounds, larger batches, a smaller buffer, a rate that falls."""

    name: str = option("quick")
    rounds: int = other_default(ProtocolOption, "rounds", 40)
    batch_size: int = other_default(ProtocolOption, "batch_size", 128)
    lr: float = other_default(ProtocolOption, "lr", 2e-3)
    lr_final: float = other_default(ProtocolOption, "lr_final", 0.05)
    epochs: int = other_default(ProtocolOption, "epochs", 3)
    capacity: int = other_default(ProtocolOption, "capacity", 5_000)
    eval_dialogues: int = other_default(ProtocolOption, "eval_dialogues", 2_000)
    eval_batch: int = other_default(ProtocolOption, "eval_batch", 2_000)
    eval_every_dialogues: int = other_default(ProtocolOption, "eval_every_dialogues", 150)
