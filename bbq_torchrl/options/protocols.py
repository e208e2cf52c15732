"""``protocol=``: how long and in which steps an agent trains and is measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.base import Option
from bbq_torchrl.options.evaluation_cost import check_evaluation
from bbq_torchrl.options.registry import register
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
    other_default,
    setting,
)

if TYPE_CHECKING:
    from bbq_torchrl.options.root import Config


__all__ = ["PaperProtocol", "ProtocolOption", "QuickProtocol"]

STORED = integers(1, 10**6)  # transitions, or outcomes of dialogues, of a replica


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

    def check(self, config: Config) -> None:
        """Refuses a buffer smaller than a batch, and evaluations longer than the training."""
        if self.capacity < self.batch_size:
            raise ConfigError(
                f"protocol.capacity must be at least protocol.batch_size ({self.batch_size}), "
                f"got {self.capacity}"
            )
        check_evaluation(config)


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
