"""Losses as native TorchRL LossModules."""

from bbq_torchrl.objectives.bbqn import BBQNLoss
from bbq_torchrl.objectives.bootstrap import BootstrapDQNLoss
from bbq_torchrl.objectives.dqn import DropoutDQNLoss
from bbq_torchrl.objectives.dynamics import DynamicsLoss
from bbq_torchrl.objectives.noisy import NoisyDQNLoss
from bbq_torchrl.objectives.q_learning import OneStepQLoss
from bbq_torchrl.objectives.vime import VIMELoss

__all__ = [
    "BBQNLoss",
    "BootstrapDQNLoss",
    "DropoutDQNLoss",
    "DynamicsLoss",
    "NoisyDQNLoss",
    "OneStepQLoss",
    "VIMELoss",
]
