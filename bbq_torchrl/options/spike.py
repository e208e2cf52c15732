"""The options of ``spike=``: the replay buffer before the first round."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.settings import (
    ANY_TEXT,
    AT_LEAST_ZERO,
    BELOW_ONE,
    BOOLEAN,
    COUNT,
    NON_NEGATIVE_INTEGER,
    POSITIVE,
    Allowed,
    ConfigError,
    option,
    optional,
    other_default,
    setting,
)

if TYPE_CHECKING:
    from torch import nn

    from bbq_torchrl.trainers import Policy, Spike


@dataclass
class SpikeOption(Option):
    """The content of the replay buffer before the first round."""

    group: ClassVar[str] = "spike"
    takes_best: ClassVar[bool] = False
    """``policy=null`` takes the best script, and not the first that succeeds."""

    dialogues: int = setting(100, NON_NEGATIVE_INTEGER, "scripted dialogues put into the buffer")
    policy: str | None = setting(
        None,
        optional(ANY_TEXT, "spike=rule: the domain's first that succeeds; best: its best"),
        "scripted policy of the domain that plays them",
    )
    protect: bool = setting(True, BOOLEAN, "never evict spiked transitions")
    drop_above: float | None = setting(
        None,
        optional(BELOW_ONE, "never"),
        "success in training above which a replica's spiked transitions are dropped for good",
    )
    drop_window: int = setting(5, COUNT, "rounds over which drop_above averages the success")
    margin: float = setting(
        0.0,
        AT_LEAST_ZERO,
        "margin, in units of Q, by which spiked actions are to be ahead of all others (DQfD); 0: "
        "they are not imitated",
    )
    margin_factor: float = setting(
        30.0, POSITIVE, "factor of the margin's loss, next to 1 for the squared error"
    )

    def check(self) -> None:
        """Refuses keys without effect."""
        if not self.dialogues:
            others = [item.name for item in fields(SpikeOption) if item.name != "dialogues"]
            self.refuse_changes(others, "spike.dialogues=0", "which spikes nothing")
        if self.drop_above is None:
            self.refuse_changes(["drop_window"], "spike.drop_above=null", "which needs no window")
        if self.drop_above is not None and not self.protect:
            raise ConfigError(
                "spike.drop_above cannot be combined with spike.protect=false: unprotected "
                "transitions are evicted anyway, so spike.drop_above must be null"
            )
        if self.margin and not self.protect:
            raise ConfigError(
                "spike.margin must be 0 with spike.protect=false, which does not tell spiked "
                f"transitions from others, got {self.margin:g}"
            )
        if not self.margin:
            self.refuse_changes(["margin_factor"], "spike.margin=0", "which imitates nothing")

    def make(self, policy: Policy) -> Spike:
        """Makes the part that fills the buffer with the policy's dialogues."""
        from bbq_torchrl.trainers import Spike

        return Spike(
            policy,
            self.dialogues,
            protect=self.protect,
            drop_above=self.drop_above,
            drop_window=self.drop_window,
        )

    def imitate(self, loss: nn.Module) -> None:
        """Adds the margin's loss to an agent's loss.

        Raises:
            ConfigError: the agent's loss cannot imitate.
        """
        if not self.margin:
            return
        imitate = getattr(loss, "imitate", None)
        if not callable(imitate):
            raise ConfigError(
                f"spike.margin must be 0 with a loss of type {type(loss).__name__}, which has no "
                f"method imitate, got {self.margin:g}"
            )
        imitate(self.margin, self.margin_factor)


@register
@dataclass
class NoSpike(SpikeOption):
    """An empty buffer."""

    name: str = option("none")
    dialogues: int = setting(
        0,
        Allowed("0, or be given with spike=rule", lambda value: value == 0),
        "scripted dialogues put into the buffer",
    )


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
