"""Options: the choices of the command line, one class each.

Each group is a page with the base class of its options and ours. Your option is one file, which
registers in the same way, by :func:`register`. Importing options imports neither torch nor Hydra;
an option's ``make`` does.
"""

from __future__ import annotations

from bbq_torchrl.options.agent import AgentOption
from bbq_torchrl.options.env import DomainOption, EnvOption
from bbq_torchrl.options.explore import Exploration, ExploreOption, IntrinsicOption
from bbq_torchrl.options.logger import LoggerOption
from bbq_torchrl.options.protocol import ProtocolOption, SpikeOption
from bbq_torchrl.options.registry import Option, explorations, register, schemas
from bbq_torchrl.options.root import CalibrateConfig, Config, EvaluateConfig, agreement, validate
from bbq_torchrl.options.task import Task

__all__ = [
    "AgentOption",
    "CalibrateConfig",
    "Config",
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
    "agreement",
    "explorations",
    "register",
    "schemas",
    "validate",
]
