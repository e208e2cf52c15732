"""One process at a time works in a run folder."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from filelock import FileLock, Timeout

from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["LOCK", "run_lock"]

LOCK = ".lock"
"""The file in a run folder that is locked; the file stays, the lock ends with its process."""


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Holds the lock of a run folder; in a process that holds it already, it is held on.

    The operating system lets the lock go when the process ends, however it ends.

    Raises:
        ConfigError: another process holds it, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder.resolve() / LOCK, is_singleton=True)
        lock.acquire(timeout=0)
    except Timeout as error:
        raise ConfigError(
            f"another process is at work in {folder}: wait until it has ended, or end it"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"{folder} cannot be used as a run folder: {error.strerror or error}"
        ) from error
    try:
        yield
    finally:
        lock.release()
