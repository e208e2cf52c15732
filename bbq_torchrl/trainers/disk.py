"""The disk under the checkpoints: room beforehand, and written for good afterwards."""

from __future__ import annotations

import errno
import os
import tempfile
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["check_room", "force_to_disk"]


def check_room(folder: Path, size: int) -> None:
    """Raises OSError where a folder's disk has no room for so many bytes; makes the folder.

    TorchRL writes through memory maps: one that meets a full disk is no error, but a signal that
    kills the process.
    """
    if not hasattr(os, "posix_fallocate"):
        return
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder) as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
                raise OSError(error.errno, error.strerror, os.fspath(folder)) from error


def force_to_disk(path: Path) -> None:
    """Has a file, or the names in a folder, outlive a crash of the machine."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
