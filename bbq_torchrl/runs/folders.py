"""The folder of a run: name, lock, configuration, and whether the run is finished.

Trained agents that come with the package are used as ``shipped:<name>`` instead of a run folder.
Each is a folder with the configuration, the result, the command line, and a checkpoint of the
Q-network's weights in half precision. ``scripts/ship_agent.py`` makes it from a finished run.
"""

from __future__ import annotations

import dataclasses
import os
import platform
from contextlib import contextmanager, suppress
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from filelock import FileLock, Timeout

from bbq_torchrl.options import Config, schemas, validate
from bbq_torchrl.settings import ConfigError, filled, walk
from bbq_torchrl.utils.files import (
    CHECKPOINTS,
    CONFIG,
    CURVE,
    HYDRA,
    LOCK,
    PROCESS,
    RESULT,
    read_yaml,
    write_text,
)
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bbq_torchrl.evaluation.run_result import RunResult

ANOTHER_SWEEP = (
    "the same command continues a sweep; give another hydra.sweep.dir, or a hydra.sweep.subdir "
    "with a separate folder for each job"
)

CHANGEABLE = (
    "protocol.rounds",
    "protocol.keep_checkpoints",
    "logger",
    "device",
    "domain.path",  # a folder may be moved
)
"""Keys and groups that may be changed with ``resume``."""

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
"""Keys and groups that a checkpoint does not depend on."""


def reserve(folder: Path) -> Path:
    """Makes a new folder: the given one, or the first free ``<folder>_<n>``."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    candidate, number = folder, 1
    while True:
        with suppress(FileExistsError):
            candidate.mkdir()
            return candidate
        number += 1
        candidate = folder.with_name(f"{folder.name}_{number}")


def refuse_links(folder: Path) -> None:
    """Refuses a folder with symbolic links where a run writes.

    By a link the folder's author could have any other file overwritten or deleted.

    Raises:
        ConfigError: the folder, or its subfolder of Hydra or the checkpoints, contains a link.
    """
    for place in (folder, folder / HYDRA, folder / CHECKPOINTS):
        for path in sorted(place.iterdir()) if place.is_dir() else ():
            if path.is_symlink():
                raise ConfigError(
                    f"{path} is a symbolic link, through which a run would write elsewhere: "
                    "replace it by its target, or remove it"
                )


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Locks a run folder; reentrant within a process.

    The operating system releases the lock when the process ends, even if it is killed.

    Raises:
        ConfigError: another process has the lock, or the folder has links.
        OSError: the folder cannot be written, or the disk is full.
    """
    folder.mkdir(parents=True, exist_ok=True)
    refuse_links(folder)
    lock = FileLock(folder.resolve() / LOCK, is_singleton=True)
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        note = folder / PROCESS
        process = note.read_text("utf-8").strip() if note.is_file() else "a process"
        raise ConfigError(f"{folder} must be free, but {process} is at work in it") from error
    try:
        write_text(folder / PROCESS, f"process {os.getpid()} on {platform.node()}\n")
        yield
    finally:
        if lock.lock_counter == 1:
            (folder / PROCESS).unlink(missing_ok=True)
        lock.release()


def save_config(config: Config, file: Path) -> None:
    """Writes a configuration as YAML, atomically."""
    write_text(file, yaml.safe_dump(dataclasses.asdict(config), sort_keys=False))


def load_config(file: Path) -> Config:
    """Reads a configuration that :func:`save_config` wrote; references in it are plain text.

    Raises:
        ConfigError: the configuration is unreadable or invalid.
    """
    try:
        plain = read_yaml(file.read_text(encoding="utf-8"))
        if not isinstance(plain, dict):
            raise ConfigError("it must hold a mapping of groups")
        options = {group: _saved_option(group, plain.get(group)) for group in schemas()}
        config = Config(**plain | options)
        validate(config)
    except (OSError, ValueError, TypeError) as error:  # the last one: an unknown key
        raise ConfigError(f"{file}: {sentence(error)}") from error
    return config


def _saved_option(group: str, plain: Any) -> Any:
    known = schemas()[group]
    name = plain.get("name") if isinstance(plain, dict) else None
    if name not in list(known):
        raise ConfigError(
            f"{group} must be one of {', '.join(sorted(known))}, got {name!r}: options of your own "
            "come with an installed package or with --config-dir <folder>"
        )
    return filled(known[name], plain, f"{group}.")


def run_config(folder: Path) -> Config:
    """Returns the configuration of a run folder.

    Raises:
        ConfigError: the folder is missing or not a run folder.
    """
    if not (folder / CONFIG).is_file():
        raise ConfigError(f"{folder} is not a run folder: it has no {CONFIG}")
    return load_config(folder / CONFIG)


def finished_result(folder: Path, rounds: int) -> RunResult | None:
    """Returns the result of a folder; None if it is missing, unreadable or of other rounds."""
    if not (folder / RESULT).is_file():
        return None
    # Imported here, since it takes a second and most folders have no result.
    from bbq_torchrl.evaluation.run_result import read_result

    try:
        result = read_result(folder)
    except (OSError, ValueError):
        return None
    return result if result.rounds == rounds else None


def is_finished(folder: Path, rounds: int) -> bool:
    """Returns whether a run folder has the result of this many rounds, and the curve."""
    return finished_result(folder, rounds) is not None and (folder / CURVE).is_file()


def restarted_config(config: Config, folder: Path, *, way: str = ANOTHER_SWEEP) -> Config:
    """Returns the configuration of a job or trial; it resumes the run in the folder, if any.

    Launchers restart a job whose worker died (Ray) or that ran out of time (SLURM).

    Args:
        config: the job's configuration for a new run.
        folder: the job's run folder.
        way: advice for a folder with another run. Defaults to that for a sweep.

    Raises:
        ConfigError: the folder has a run of another configuration.
    """
    if not (folder / CONFIG).is_file():
        return config
    if run_config(folder) != dataclasses.replace(config, resume=None):
        raise ConfigError(f"{folder} already holds another run: {way}")
    return dataclasses.replace(config, resume=str(folder))


def config_fingerprint(config: Config) -> dict[str, Any]:
    """Returns the settings that a checkpoint depends on, as JSON values by dotted key."""
    return {
        key: value
        for key, _, value in walk(config)
        if not {key, key.partition(".")[0]} & set(_NOT_OF_THE_TRAINING)
    }


SHIPPED = Path(__file__).resolve().parent / "shipped"
"""The folder of the shipped agents."""

PREFIX = "shipped:"


def shipped_agents() -> list[str]:
    """Returns the names of the shipped agents."""
    return sorted(file.parent.name for file in SHIPPED.glob("*/config.yaml"))


def run_folder(place: Path | str, base: Path | None = None) -> Path:
    """Returns the folder of a shipped agent, or a run folder.

    Args:
        place: ``shipped:<name>`` or a path.
        base: the folder that relative paths start from. Defaults to the working directory.

    Raises:
        ConfigError: no shipped agent has that name.

    Examples:
        >>> run_folder("shipped:bbqn_map").name
        'bbqn_map'
    """
    text = str(place)
    if not text.startswith(PREFIX):
        return (base or Path()) / Path(expanduser(place))
    name, known = text.removeprefix(PREFIX), shipped_agents()
    if name not in known:
        raise ConfigError(f"{PREFIX}<name> must name one of {', '.join(known)}, got {shown(text)}")
    return SHIPPED / name


def is_shipped(folder: Path) -> bool:
    """Returns whether a folder belongs to a shipped agent."""
    return folder.resolve().parent == SHIPPED
