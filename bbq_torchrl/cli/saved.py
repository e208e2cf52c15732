"""The configuration in a run folder: written, and read again, of earlier versions too."""

from __future__ import annotations

from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf

from bbq_torchrl.cli.store import typed
from bbq_torchrl.options import Config, ConfigError
from bbq_torchrl.run_folder import write_text

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["load_config", "save_config"]

_ADDED = {"intrinsic": "none"}
"""Groups that configurations of earlier versions lack, and the option that those versions were."""

_ADDED_KEYS = {"protocol": {"eval_every": 0}}
"""Keys that configurations of earlier versions lack, and what those versions did."""

_REMOVED_KEYS = ("cuda_graph",)
"""Keys of earlier versions that changed no number."""


def save_config(config: Config, file: Path) -> None:
    """Writes a configuration as YAML, atomically, so that a reader never sees half of it."""
    write_text(file, OmegaConf.to_yaml(OmegaConf.structured(config)))


def load_config(file: Path) -> Config:
    """Reads a configuration that :func:`save_config` wrote; keys it lacks take their defaults.

    Raises:
        ConfigError: no readable configuration, or one that cannot be run.
    """
    try:
        plain = OmegaConf.load(file)
    except OSError as error:
        raise ConfigError(f"{file} cannot be read: {error.strerror}") from error
    except Exception as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise ConfigError(f"{file} is not a YAML file of a run: {reason}") from error
    if not isinstance(plain, DictConfig):
        raise ConfigError(f"{file} must hold a mapping of groups, got a list")
    for key in _REMOVED_KEYS:
        plain.pop(key, None)
    for group, option in _ADDED.items():
        if group not in plain and "agent" in plain:
            plain[group] = {"name": option}
    for group, keys in _ADDED_KEYS.items():
        if OmegaConf.is_dict(plain.get(group)):
            for key, value in keys.items():
                if key not in plain[group]:
                    plain[group][key] = value
    try:
        return typed(plain, Config)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from error
