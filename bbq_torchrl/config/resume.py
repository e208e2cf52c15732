"""Going on with a run: its folder's configuration, and the few keys that may differ from it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl.config.schema import EXPERIMENT
from bbq_torchrl.config.settings import ConfigError
from bbq_torchrl.config.store import load_config

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.config.schema import Config

__all__ = [
    "RESULT",
    "RUN_CONFIG",
    "restarted_config",
    "resumed_config",
    "run_config",
]

RUN_CONFIG = "config.yaml"
"""The composed configuration in a run folder."""

RESULT = "result.json"
"""The final evaluation in a run folder: it is there when the run is finished."""

CHANGEABLE = ("protocol.rounds", "logger", "device")
"""What may be given beside ``resume``; the rest is the run's own."""


def run_config(folder: Path) -> Config:
    """The configuration of a run folder.

    Raises:
        ConfigError: the folder is not there, or is no run folder.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder} is not a run folder: there is no such folder")
    if not (folder / RUN_CONFIG).is_file():
        raise ConfigError(f"{folder} is not a run folder: it has no {RUN_CONFIG}")
    return load_config(folder / RUN_CONFIG)


def resumed_config(given: Config, overrides: Sequence[str]) -> Config:
    """The configuration of the run ``given.resume``, with the changes that are allowed.

    Args:
        given: the configuration that the command line alone stands for.
        overrides: the command line.

    Raises:
        ConfigError: no run folder, a finished run, or an override that contradicts the run.
    """
    assert given.resume is not None
    folder = Path(given.resume).expanduser().resolve()
    saved = run_config(folder)
    config = dataclasses.replace(saved, resume=str(folder))
    for override in overrides:
        key = override.lstrip("+~").partition("=")[0]
        if key == "resume":
            continue
        if key in (EXPERIMENT, "hydra.run.dir"):
            raise ConfigError(_refusal(override, folder))
        if key == "protocol.rounds":
            config.protocol.rounds = _extended(saved, given, folder)
        elif key.partition(".")[0] == "logger":
            config.logger = given.logger
        elif key == "device":
            config.device = given.device
        elif _value(given, key) != _value(saved, key):
            raise ConfigError(_refusal(override, folder))
    if (folder / RESULT).is_file() and config.protocol.rounds == run_config(folder).protocol.rounds:
        raise ConfigError(
            f"the run in {folder} is finished ({config.protocol.rounds} rounds): "
            f"protocol.rounds=<more> extends it"
        )
    return config


def restarted_config(config: Config, folder: Path) -> Config:
    """The configuration of a job of a sweep: it goes on with what its folder holds already.

    Launchers start a job again whose worker died (Ray) or that ran out of time (SLURM).

    Raises:
        ConfigError: the folder holds a run of another configuration.
    """
    if not (folder / RUN_CONFIG).is_file():
        return config
    if run_config(folder) != dataclasses.replace(config, resume=None):
        raise ConfigError(
            f"{folder} already holds another run: hydra.sweep.subdir must give each job of a "
            f"sweep a folder of its own"
        )
    return dataclasses.replace(config, resume=str(folder))


def _extended(saved: Config, given: Config, folder: Path) -> int:
    before, after = saved.protocol.rounds, given.protocol.rounds
    if after < before:
        raise ConfigError(
            f"protocol.rounds must be at least {before}, which {folder} was started with, "
            f"got {after}"
        )
    return after


def _refusal(override: str, folder: Path) -> str:
    return (
        f"{override} contradicts the run in {folder}: beside resume only "
        f"{', '.join(CHANGEABLE)} can be given"
    )


def _value(config: Any, key: str) -> Any:
    """The value of a dotted key; the option's name where the key is a group."""
    for name in key.split("."):
        config = getattr(config, name, None)
    return getattr(config, "name", config)
