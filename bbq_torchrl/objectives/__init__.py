"""Losses as native TorchRL LossModules."""

from bbq_torchrl.objectives.bbqn import BBQNLoss
from bbq_torchrl.objectives.dqn import BootstrapDQNLoss, DropoutDQNLoss, NoisyDQNLoss
from bbq_torchrl.objectives.gp_loss import GPLoss
from bbq_torchrl.objectives.q_learning import OneStepQLoss

__all__ = [
    "BBQNLoss",
    "BootstrapDQNLoss",
    "DropoutDQNLoss",
    "GPLoss",
    "NoisyDQNLoss",
    "OneStepQLoss",
]
