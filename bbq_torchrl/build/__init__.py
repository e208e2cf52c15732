"""From configuration to objects: the only package that knows every part."""

from __future__ import annotations

from bbq_torchrl.build.agents import Agent, build_agent
from bbq_torchrl.build.checks import check, check_device
from bbq_torchrl.build.training import build_trainer, evaluation_places
from bbq_torchrl.build.worlds import build_domain, build_env

__all__ = [
    "Agent",
    "build_agent",
    "build_domain",
    "build_env",
    "build_trainer",
    "check",
    "check_device",
    "evaluation_places",
]
