"""Q-networks with a replica dimension, and actors built on them."""

from __future__ import annotations

from bbq_torchrl.networks.bootstrap import BootstrapMLP, bootstrap_actor
from bbq_torchrl.networks.gaussian_process import GaussianProcess
from bbq_torchrl.networks.mlp import FlatMLP, NoisyMLP, ReplicaNoisyLinear
from bbq_torchrl.networks.q_actor import q_actor

__all__ = [
    "BootstrapMLP",
    "FlatMLP",
    "GaussianProcess",
    "NoisyMLP",
    "ReplicaNoisyLinear",
    "bootstrap_actor",
    "q_actor",
]
