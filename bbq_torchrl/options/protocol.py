"""The options of ``protocol=``, the schedule of training, and ``spike=``, the buffer before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.settings import (
    ANY_TEXT,
    AT_LEAST_ZERO,
    BATCH,
    BELOW_ONE,
    BOOLEAN,
    COUNT,
    NON_NEGATIVE_INTEGER,
    POSITIVE,
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

if TYPE_CHECKING:
    from bbq_torchrl.trainers import Policy, Spike

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


@dataclass
class SpikeOption(Option):
    """The content of the replay buffer before the first round."""

    group: ClassVar[str] = "spike"
    takes_best: ClassVar[bool] = False
    """``policy=null`` takes the best script, and not the first that succeeds."""

    dialogues: int = setting(100, NON_NEGATIVE_INTEGER, "scripted dialogues put into the buffer")
    policy: str | None = setting(
        None, optional(ANY_TEXT, "rule: the first that succeeds; best: the best"), "script of them"
    )
    protect: bool = setting(True, BOOLEAN, "never evict spiked transitions")
    successes: int = setting(
        0, NON_NEGATIVE_INTEGER, "newest successful dialogues that are never evicted"
    )
    margin: float = setting(
        0.0, AT_LEAST_ZERO, "margin of spiked actions (DQfD), in units of Q; 0: not imitated"
    )
    margin_factor: float = setting(30.0, POSITIVE, "factor of the margin's loss")

    def check(self) -> None:
        """Refuses imitation of transitions that are not there or cannot be told from others."""
        if self.margin and not self.dialogues:
            raise ConfigError(
                f"spike.dialogues must be at least 1 with spike.margin={self.margin:g}, got 0"
            )
        if self.margin and not self.protect:
            raise ConfigError(
                "spike.margin must be 0 with spike.protect=false, which does not tell spiked "
                f"transitions from others, got {self.margin:g}"
            )

    def make(self, policy: Policy) -> Spike:
        """Makes the part that fills the buffer with the policy's dialogues."""
        from bbq_torchrl.trainers import Spike

        return Spike(policy, self.dialogues, protect=self.protect)

    def imitate(self, loss: Any) -> None:
        """Adds the margin's loss to an agent's loss, by its method ``imitate``."""
        if self.margin:
            loss.imitate(self.margin, self.margin_factor)


@register
@dataclass
class NoSpike(SpikeOption):
    """An empty buffer."""

    name: str = option("none")
    dialogues: int = setting(0, integers(0, 0), "scripted dialogues put into the buffer")


@register
@dataclass
class RuleSpike(SpikeOption):
    """Replay-buffer spiking: dialogues of a scripted policy."""

    name: str = option("rule")


@register
@dataclass
class BestSpike(SpikeOption):
    """Replay-buffer spiking: dialogues of the domain's best script."""

    name: str = option("best")
    takes_best: ClassVar[bool] = True


@register
@dataclass
class ImitatedSpike(BestSpike):
    """Dialogues of the domain's best script, whose actions are imitated (DQfD's margin loss)."""

    name: str = option("imitate")
    margin: float = other_default(SpikeOption, "margin", 5.0)
