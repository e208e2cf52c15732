"""Configuration: dataclass schemas for every key, and the checks before anything runs.

Importing this package imports neither torch nor Hydra; ``bbq_torchrl.config.store`` composes.
"""

from __future__ import annotations

from bbq_torchrl.config.pairs import EXPLORATIONS, explorations_table
from bbq_torchrl.config.schema import SCHEMAS, CalibrateConfig, Config, EvaluateConfig
from bbq_torchrl.config.settings import ConfigError, check_settings
from bbq_torchrl.config.validation import validate

__all__ = [
    "EXPLORATIONS",
    "SCHEMAS",
    "CalibrateConfig",
    "Config",
    "ConfigError",
    "EvaluateConfig",
    "check_settings",
    "explorations_table",
    "validate",
]
