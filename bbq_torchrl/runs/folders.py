"""The folder of a run or a sweep: name, creation and lock."""

from __future__ import annotations

import os
import platform
import re
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import FileLock, Timeout
from omegaconf.errors import OmegaConfBaseException

from bbq_torchrl.runs.overrides import key_of
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils.files import CHECKPOINTS, CONFIG, HYDRA, LOCK, PROCESS, write_text
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from contextlib import ExitStack

    from omegaconf import DictConfig


def refuse_other_folder(overrides: Sequence[str], other: str, its: str, own: str) -> None:
    """Refuses ``hydra.sweep.dir`` for a single run, and ``hydra.run.dir`` for a sweep."""
    for override in overrides:
        if re.match(rf"[+]*hydra\.{other}\.\w+=", override):
            raise ConfigError(
                f"{sentence(override)} is for {its}: here it is hydra.{own}.dir=<folder>"
            )


def run_folder(composed: DictConfig, overrides: Sequence[str], locks: ExitStack) -> Path:
    """Returns the folder of a new run, locked: ``hydra.run.dir``, or a free default name."""
    folder = named_folder(composed, "run")
    if "hydra.run.dir" not in map(key_of, overrides):
        folder = reserve(folder)
    locks.enter_context(run_lock(folder))
    if (folder / CONFIG).exists():
        raise ConfigError(f"{folder} already holds a run; continue it by resume={folder}")
    return folder


def named_folder(composed: DictConfig, kind: str) -> Path:
    """Returns the folder that ``hydra.run.dir`` or ``hydra.sweep.dir`` names."""
    key = f"hydra.{kind}.dir"
    try:
        name = str(composed.hydra[kind].dir)
    except OmegaConfBaseException as error:
        raise ConfigError(f"{key} cannot be resolved: {str(error).splitlines()[0]}") from error
    if not name.strip():
        raise ConfigError(f"{key} must be the name of a folder, got {name!r}")
    return Path(name)


def reserve(folder: Path) -> Path:
    """Makes a new folder: the given one, or the first free ``<folder>_<n>``."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    candidate, number = folder, 1
    while True:
        try:
            candidate.mkdir()
        except FileExistsError:
            number += 1
            candidate = folder.with_name(f"{folder.name}_{number}")
        else:
            return candidate


def quoted(path: Path | str) -> str:
    """Returns a path quoted for Hydra."""
    text = os.fspath(path).replace("\\", "\\\\").replace("'", "\\'")
    return f"'{text}'"


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
        ConfigError: another process has the lock, the folder cannot be written, or it has links.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        refuse_links(folder)
        lock = FileLock(folder.resolve() / LOCK, is_singleton=True)
        lock.acquire(timeout=0)
    except Timeout as error:
        raise ConfigError(
            f"another process is at work in {folder}: wait until {_named(folder)} has ended, or "
            "end it"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"{folder} cannot be used as a run folder: {error.strerror or error}"
        ) from error
    note = folder / PROCESS
    with suppress(OSError):  # the note only improves an error message
        write_text(note, f"{os.getpid()} on {platform.node()}\n")
    try:
        yield
    finally:
        if lock.lock_counter == 1:
            with suppress(OSError):
                note.unlink()
        lock.release()


def _named(folder: Path) -> str:
    """Returns the process noted in a folder; ``it`` without a note."""
    with suppress(OSError, ValueError):
        if noted := re.fullmatch(r"(\d+) on ([\w.-]+)\n", (folder / PROCESS).read_text("utf-8")):
            return f"process {noted[1]} on {noted[2]}"
    return "it"
