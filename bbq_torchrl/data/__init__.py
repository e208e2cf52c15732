"""Replay buffers with spiking, on TorchRL's storages, samplers and writers."""

from __future__ import annotations

from bbq_torchrl.data.bootstrap_mask import BootstrapMask
from bbq_torchrl.data.replay import TRANSITION_KEYS, ReplicaReplay
from bbq_torchrl.data.rows import Batch, validate_transitions
from bbq_torchrl.data.writers import ProtectedRoundRobinWriter

__all__ = [
    "TRANSITION_KEYS",
    "Batch",
    "BootstrapMask",
    "ProtectedRoundRobinWriter",
    "ReplicaReplay",
    "validate_transitions",
]
