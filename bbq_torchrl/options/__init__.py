"""Options: what can be chosen on the command line, one class in one file each.

Importing this package imports neither torch nor Hydra; an option's ``make`` does.
"""

from __future__ import annotations

from bbq_torchrl.options.base import (
    AgentOption,
    DomainOption,
    Exploration,
    ExploreOption,
    IntrinsicOption,
    LoggerOption,
    Option,
)
from bbq_torchrl.options.env_base import EnvOption
from bbq_torchrl.options.registry import explorations, register, schemas
from bbq_torchrl.options.root import CalibrateConfig, Config, EvaluateConfig, validate
from bbq_torchrl.options.settings import ConfigError, check_settings
from bbq_torchrl.options.task import Task

__all__ = [
    "AgentOption",
    "CalibrateConfig",
    "Config",
    "ConfigError",
    "DomainOption",
    "EnvOption",
    "EvaluateConfig",
    "Exploration",
    "ExploreOption",
    "IntrinsicOption",
    "LoggerOption",
    "Option",
    "Task",
    "check_settings",
    "explorations",
    "register",
    "schemas",
    "validate",
]
