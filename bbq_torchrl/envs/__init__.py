"""Environments: dialogues as a TorchRL environment, and who can play in it."""

from __future__ import annotations

from bbq_torchrl.envs.dialogue import DialogueEnv
from bbq_torchrl.envs.policies import scripted_policy
from bbq_torchrl.envs.schedule import ExtensionSchedule

__all__ = ["DialogueEnv", "ExtensionSchedule", "scripted_policy"]
