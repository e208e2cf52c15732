"""The configuration in a run folder: written, read, also of earlier versions, and gone on with."""

from __future__ import annotations

import copy
import dataclasses
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bbq_torchrl.cli.messages import key_of
from bbq_torchrl.cli.store import read_config, run_of
from bbq_torchrl.options.registry import EXPERIMENT
from bbq_torchrl.options.root import validate
from bbq_torchrl.options.settings import ConfigError, walk
from bbq_torchrl.run_folder import CONFIG, CURVE, RESULT, write_text
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.evaluation.results import RunResult
    from bbq_torchrl.options import Config

__all__ = [
    "description",
    "folder_to_resume",
    "is_finished",
    "load_config",
    "restarted_config",
    "result_of",
    "resumed_config",
    "run_config",
    "run_to_resume",
    "save_config",
]

CHANGEABLE = (
    "protocol.rounds",
    "protocol.keep_checkpoints",
    "logger",
    "device",
    "domain.path",  # a folder may be moved
)
"""What may be given beside ``resume``; the rest is the run's own."""

_NOT_OF_THE_TRAINING = (
    *CHANGEABLE,
    "resume",
    "threads",
    "protocol.checkpoint_every",
    "protocol.eval_dialogues",
    "protocol.eval_batch",
    "protocol.eval_every",
    "protocol.eval_every_dialogues",
    "agent.evaluate",
    "agent.evaluate_draws",
)
"""Keys, and groups, that a checkpoint does not depend on."""

_ADDED = {"intrinsic": {"name": "none"}, "protocol": {"eval_every": 0}}
"""Groups and keys that configurations of earlier versions lack, and what those versions did."""

_REMOVED_KEYS = ("cuda_graph",)
"""Keys of earlier versions that changed no number."""


def description(config: Config) -> dict[str, Any]:
    """What a checkpoint of a run depends on, as JSON values by dotted key."""
    return {
        key: value
        for key, _, value in walk(config)
        if not {key, key.partition(".")[0]} & set(_NOT_OF_THE_TRAINING)
    }


def result_of(folder: Path, rounds: int) -> RunResult | None:
    """The final evaluation of a training of so many rounds; None if there is none to be read."""
    if not (folder / RESULT).is_file():
        return None
    # Imported here: it takes a second, and most folders have none.
    from bbq_torchrl.evaluation.results import read_result

    try:
        result = read_result(folder)
    except (OSError, ValueError):
        return None
    return result if result.rounds == rounds else None


def is_finished(folder: Path, rounds: int) -> bool:
    """Whether nothing is left to do in a run folder whose configuration asks for so many rounds."""
    return result_of(folder, rounds) is not None and (folder / CURVE).is_file()


def run_config(folder: Path) -> Config:
    """The configuration of a run folder.

    Raises:
        ConfigError: the folder is not there, or is no run folder.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder} is not a run folder: there is no such folder")
    if not (folder / CONFIG).is_file():
        raise ConfigError(f"{folder} is not a run folder: it has no {CONFIG}")
    return load_config(folder / CONFIG)


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
    try:
        is_whole = OmegaConf.is_dict(plain.get("protocol"))
        complete = OmegaConf.merge(plain, _ADDED, plain) if is_whole else plain
        assert isinstance(complete, DictConfig)
        return read_config(complete)
    except (ConfigError, OmegaConfBaseException) as error:
        raise ConfigError(f"{file}: {sentence(error)}") from error


def folder_to_resume(resume: str | None) -> Path | None:
    """The run folder that ``resume=`` names, if it is one."""
    folder = Path(expanduser(resume)).resolve() if resume else None
    return folder if folder is not None and (folder / CONFIG).is_file() else None


def run_to_resume(overrides: Sequence[str]) -> Config | None:
    """The configuration of ``resume=<run folder>``, on whose values a command line is read.

    None where there is none, and where another option or an experiment is given: that is
    refused by :func:`resumed_config`, whatever the combination.
    """
    folder = folder_to_resume(run_of(overrides, "resume"))
    if folder is None:
        return None
    run = run_config(folder)
    for override in overrides:
        key, value = key_of(override), override.partition("=")[2]
        if key.partition("/")[0] == EXPERIMENT:
            return None
        own = getattr(run, key, None) if key not in CHANGEABLE else None
        if dataclasses.is_dataclass(own) and value.strip("'\"") != _value(run, key):
            return None
    return run


def resumed_config(given: Config, overrides: Sequence[str]) -> Config:
    """The configuration of the run ``given.resume``, with the changes that are allowed.

    Args:
        given: the configuration that the command line stands for, on the run's values.
        overrides: the command line.

    Raises:
        ConfigError: no run folder, a finished run, an override that contradicts the run, or a run
            that cannot be gone on with so.
    """
    assert given.resume is not None
    folder = Path(expanduser(given.resume)).resolve()
    saved = run_config(folder)
    config = copy.deepcopy(saved)
    config.resume = str(folder)
    for override in overrides:
        key = key_of(override)
        if key == "resume":
            continue
        group, _, name = key.partition(".")
        if group in CHANGEABLE:
            setattr(config, group, getattr(given, group))
        elif key in CHANGEABLE:
            setattr(getattr(config, group), name, getattr(getattr(given, group), name))
        elif (
            key.partition("/")[0] == EXPERIMENT
            or key == "hydra.run.dir"
            or _value(given, key) != _value(saved, key)
        ):
            raise ConfigError(
                f"{override} contradicts the run in {folder}: beside resume only "
                f"{', '.join(CHANGEABLE)} can be given"
            )
    if config.protocol.rounds < saved.protocol.rounds:
        raise ConfigError(
            f"protocol.rounds must be at least {saved.protocol.rounds}, which {folder} was started "
            f"with, got {config.protocol.rounds}"
        )
    if is_finished(folder, config.protocol.rounds):
        only = " of a run with protocol.keep_checkpoints=last"
        extended = only if config.protocol.keep_checkpoints == "weights" else ""
        raise ConfigError(
            f"the run in {folder} is finished ({config.protocol.rounds} rounds): "
            f"protocol.rounds=<more> goes on beyond the end{extended}"
        )
    validate(config)  # more rounds may reach an evaluation that the saved ones did not
    return config


def restarted_config(config: Config, folder: Path) -> Config:
    """The configuration of a job of a sweep: it goes on with what its folder holds already.

    Launchers start a job again whose worker died (Ray) or that ran out of time (SLURM).

    Raises:
        ConfigError: the folder holds a run of another configuration.
    """
    if not (folder / CONFIG).is_file():
        return config
    if run_config(folder) != dataclasses.replace(config, resume=None):
        raise ConfigError(
            f"{folder} already holds another run: a sweep goes on by the same command; give "
            "another hydra.sweep.dir, or a hydra.sweep.subdir with a folder of its own for each job"
        )
    return dataclasses.replace(config, resume=str(folder))


def _value(config: Any, key: str) -> Any:
    """The value of a dotted key; the option's name where the key is a group."""
    for name in key.split("."):
        config = getattr(config, name, None)
    return getattr(config, "name", config)
