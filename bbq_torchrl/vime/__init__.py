"""VIME (Houthooft et al. 2016): dynamics, their information gain, and the reward it gives."""

from __future__ import annotations

from bbq_torchrl.vime.dynamics import DynamicsModel
from bbq_torchrl.vime.dynamics_loss import DynamicsLoss, vime_losses
from bbq_torchrl.vime.information_gain import information_gain
from bbq_torchrl.vime.reward import VIMEReward

__all__ = [
    "DynamicsLoss",
    "DynamicsModel",
    "VIMEReward",
    "information_gain",
    "vime_losses",
]
