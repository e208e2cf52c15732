"""Environments: dialogues as a TorchRL environment, and scripted policies for it."""

from __future__ import annotations

from bbq_torchrl.envs.clairvoyant import ClairvoyantPolicy
from bbq_torchrl.envs.dialogue import DialogueEnv
from bbq_torchrl.envs.policies import (
    CarefulPolicy,
    SequencePolicy,
    UniformPolicy,
    scripted_policy,
)
from bbq_torchrl.envs.repair import RepairPolicy
from bbq_torchrl.envs.schedule import ExtensionSchedule
from bbq_torchrl.envs.state import EnvState

__all__ = [
    "CarefulPolicy",
    "ClairvoyantPolicy",
    "DialogueEnv",
    "EnvState",
    "ExtensionSchedule",
    "RepairPolicy",
    "SequencePolicy",
    "UniformPolicy",
    "scripted_policy",
]
