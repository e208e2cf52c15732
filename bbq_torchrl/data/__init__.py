"""Replay buffers with spiking, on TorchRL's storages, samplers and writers."""

from __future__ import annotations

from bbq_torchrl.data.bootstrap_mask import BootstrapMask
from bbq_torchrl.data.replay import TRANSITION_KEYS, ReplicaReplay
from bbq_torchrl.data.rows import Batch, ProtectedRoundRobinWriter, validate_transitions

__all__ = [
    "TRANSITION_KEYS",
    "Batch",
    "BootstrapMask",
    "ProtectedRoundRobinWriter",
    "ReplicaReplay",
    "validate_transitions",
]
