"""``intrinsic=none``: the task's reward alone."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.options import IntrinsicOption, register
from bbq_torchrl.options.settings import option


@register
@dataclass
class NoIntrinsic(IntrinsicOption):
    """The task's reward alone."""

    name: str = option("none")
