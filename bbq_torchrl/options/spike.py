"""The options of ``spike=``: the replay buffer before the first round."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.options.settings import (
    ANY_TEXT,
    BELOW_ONE,
    BOOLEAN,
    COUNT,
    NON_NEGATIVE_INTEGER,
    Allowed,
    ConfigError,
    option,
    optional,
    setting,
)
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from bbq_torchrl.trainers import Policy, Spike


@dataclass
class SpikeOption(Option):
    """The content of the replay buffer before the first round."""

    group: ClassVar[str] = "spike"
    takes_best: ClassVar[bool] = False
    """Whether ``policy=null`` takes the best script, and not the first that succeeds."""

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

    def check(self) -> None:
        """Refuses keys without effect."""
        for item in fields(SpikeOption):
            value, default = getattr(self, item.name), getattr(type(self), item.name)
            if not self.dialogues and item.name != "dialogues" and value != default:
                raise ConfigError(
                    f"spike.{item.name} must be {json.dumps(default)} with spike.dialogues=0, "
                    f"which spikes nothing, got {shown(value)}"
                )
        if self.drop_above is None and self.drop_window != type(self).drop_window:
            raise ConfigError(
                f"spike.drop_window must be {type(self).drop_window} with spike.drop_above=null, "
                f"which needs no window, got {self.drop_window}"
            )
        if self.drop_above is not None and not self.protect:
            raise ConfigError(
                "spike.drop_above cannot be combined with spike.protect=false: unprotected "
                "transitions are evicted anyway, so spike.drop_above must be null"
            )

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
