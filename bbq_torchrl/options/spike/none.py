"""``spike=none``: an empty buffer."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.options import SpikeOption, register
from bbq_torchrl.options.settings import Allowed, option, setting


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
