"""``protocol=paper``: the paper's protocol."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.options import ProtocolOption, register
from bbq_torchrl.options.settings import option


@register
@dataclass
class PaperProtocol(ProtocolOption):
    """The paper's protocol."""

    name: str = option("paper")
