"""The options of ``spike=``: the replay buffer before the first round."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.settings import (
    ANY_TEXT,
    AT_LEAST_ZERO,
    BOOLEAN,
    NON_NEGATIVE_INTEGER,
    POSITIVE,
    ConfigError,
    integers,
    option,
    optional,
    other_default,
    setting,
)

if TYPE_CHECKING:
    from bbq_torchrl.trainers import Policy, Spike


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
