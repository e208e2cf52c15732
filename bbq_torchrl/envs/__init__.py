"""Environments: dialogues as a TorchRL environment, and scripted policies for it."""

from __future__ import annotations

from bbq_torchrl.envs.dialogue import DialogueEnv, EnvState, ExtensionSchedule
from bbq_torchrl.envs.policies import (
    CarefulPolicy,
    ClairvoyantPolicy,
    RepairPolicy,
    SequencePolicy,
    UniformPolicy,
    scripted_policy,
)

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
