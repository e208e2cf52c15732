"""``spike=rule``: dialogues of a scripted policy."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.options import SpikeOption, register
from bbq_torchrl.options.settings import option


@register
@dataclass
class RuleSpike(SpikeOption):
    """Replay-buffer spiking: dialogues of a scripted policy."""

    name: str = option("rule")
