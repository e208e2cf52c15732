"""VIME (Houthooft et al. 2016): dynamics model, information gain and intrinsic reward."""

from __future__ import annotations

from bbq_torchrl.vime.dynamics import DynamicsLoss, DynamicsModel, vime_losses
from bbq_torchrl.vime.reward import VIMEReward, information_gain

__all__ = [
    "DynamicsLoss",
    "DynamicsModel",
    "VIMEReward",
    "information_gain",
    "vime_losses",
]
