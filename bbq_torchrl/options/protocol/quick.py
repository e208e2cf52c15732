"""``protocol=quick``: a minute on one core."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.options import ProtocolOption, register
from bbq_torchrl.options.settings import option, other_default


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
