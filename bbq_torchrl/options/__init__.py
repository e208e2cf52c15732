"""Options: what can be chosen on the command line, one class in one file each.

A group is a package here, which says what an option of it is; every module in it is an option:
``explore=noisy`` is ``explore/noisy.py``. Importing them imports neither torch nor Hydra; an
option's ``make`` does.
"""

from __future__ import annotations

from bbq_torchrl.options.agent import AgentOption
from bbq_torchrl.options.base import Option
from bbq_torchrl.options.domain import DomainOption
from bbq_torchrl.options.env import EnvOption
from bbq_torchrl.options.explore import Exploration, ExploreOption
from bbq_torchrl.options.intrinsic import IntrinsicOption
from bbq_torchrl.options.logger import LoggerOption
from bbq_torchrl.options.protocol import ProtocolOption
from bbq_torchrl.options.registry import explorations, register, schemas
from bbq_torchrl.options.root import CalibrateConfig, Config, EvaluateConfig, validate
from bbq_torchrl.options.settings import ConfigError, check_settings
from bbq_torchrl.options.spike import SpikeOption
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
    "ProtocolOption",
    "SpikeOption",
    "Task",
    "check_settings",
    "explorations",
    "register",
    "schemas",
    "validate",
]
