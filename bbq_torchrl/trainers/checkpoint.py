"""Checkpoints that survive a kill, a crash and a damaged disk.

A checkpoint is one :class:`torchrl.checkpoint.Checkpoint` archive: a ZIP file of raw tensors and
JSON (nothing in it is pickled, so loading one runs no code), published by a rename. What TorchRL's
``CheckpointRotation`` leaves open is done here:

- it skips files that it cannot read without a word, and does not notice a damaged tensor: here
  every byte is checked (the ZIP's CRC-32) before anything is loaded, a damaged file is named in a
  warning, and the one before it is used;
- nothing is forced to the disk: here the archive and its folder are, before older ones go;
- a process killed while it writes leaves its staging folder behind: here the next one removes it.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import struct
import zipfile
import zlib
from typing import TYPE_CHECKING, Any

from torchrl.checkpoint import Checkpoint

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["CheckpointDamagedError", "CheckpointFolder"]

_LOG = logging.getLogger(__name__)
_SUFFIX = ".torchrl"
_NAME = re.compile(r"round-(\d{6,})\.torchrl")
_LEFTOVER = re.compile(r"\..+\.torchrl\.(stage|archive|backup)-[0-9a-f]{32}")
_READ_ERRORS = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    RuntimeError,  # TorchRL's CheckpointError, and zipfile's word for flags that make no sense
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


class CheckpointDamagedError(RuntimeError):
    """No checkpoint of a run can be read."""


class CheckpointFolder:
    """The last checkpoints of a run, the newest readable one first.

    Args:
        folder (Path): where they lie; it is made when the first is saved.
        keep (int): how many are kept. Default: 2, so that one remains if the newest is damaged.
        **components: what is saved and restored, by name: objects with ``state_dict`` and
            ``load_state_dict``, or lists and dicts of JSON values, which are restored in place.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from torch import nn
        >>> with TemporaryDirectory() as folder:
        ...     saved = CheckpointFolder(Path(folder), network=nn.Linear(2, 1)).save(3, {"seed": 0})
        ...     path, metadata = CheckpointFolder(Path(folder)).newest()
        ...     print(path.name, metadata)
        round-000003.torchrl {'round': 3, 'seed': 0}
    """

    def __init__(self, folder: Path, *, keep: int = 2, **components: Any) -> None:
        if keep < 1:
            raise ValueError(f"keep must be at least 1, got {keep}")
        self.folder = folder
        self.keep = keep
        self._checkpoint = Checkpoint(format="archive", **components)

    def save(self, rounds: int, metadata: Mapping[str, Any], *, name: str | None = None) -> Path:
        """Saves all components and returns the file; older checkpoints go once it is safe.

        Args:
            rounds (int): how many rounds are done.
            metadata (mapping): JSON values, read again without loading anything.
            name (str, optional): a name of its own, outside the rotation. Default: the round's.
        """
        path = self.folder / f"{name or f'round-{rounds:06d}'}{_SUFFIX}"
        self._checkpoint.save(path, metadata={"round": rounds, **metadata})
        _force_to_disk(path)
        _force_to_disk(self.folder)
        if name is None:
            for old in self._files()[self.keep :]:
                old.unlink()
        return path

    def newest(self) -> tuple[Path, dict[str, Any]] | None:
        """Returns the newest readable checkpoint and its metadata, or None if there is none at all.

        Raises:
            CheckpointDamagedError: if there are checkpoints, but every one is damaged.
        """
        self._remove_leftovers()
        files = self._files()
        damages: list[str] = []
        for path in files:
            damage = _damage(path)
            if damage is None:
                if damages:
                    _LOG.warning("resuming from the checkpoint before it: %s", path)
                return path, dict(Checkpoint.manifest(path)["metadata"])
            _LOG.warning("checkpoint is damaged and not used: %s (%s)", path, damage)
            damages.append(f"{path.name}: {damage}")
        if damages:
            raise CheckpointDamagedError(
                f"every checkpoint in {self.folder} is damaged ({'; '.join(damages)})"
            )
        return None

    def load(self, path: Path) -> None:
        """Restores all components from a checkpoint.

        Raises:
            torchrl.checkpoint.CheckpointError: if it was made by another configuration.
        """
        # Each part moves its state to its own device: the run may go on where the device that it
        # was saved from is absent.
        self._checkpoint.load(path, map_location="cpu")

    def _files(self) -> list[Path]:
        """Returns the checkpoints of finished rounds, the newest first."""
        if not self.folder.is_dir():
            return []
        numbered = [
            (int(match[1]), path)
            for path in self.folder.iterdir()
            if (match := _NAME.fullmatch(path.name)) is not None
        ]
        return [path for _, path in sorted(numbered, reverse=True)]

    def _remove_leftovers(self) -> None:
        """Removes what a process that was killed while saving left behind."""
        if not self.folder.is_dir():
            return
        for path in self.folder.iterdir():
            if _LEFTOVER.fullmatch(path.name):
                if path.is_dir():
                    shutil.rmtree(path)
                else:
                    path.unlink()


def _damage(path: Path) -> str | None:
    """Returns what is wrong with an archive, read to its last byte, or None."""
    try:
        with zipfile.ZipFile(path) as archive:
            broken = archive.testzip()
            if broken is not None:
                return f"{broken} in it does not match its checksum"
            present = set(archive.namelist())
        components = Checkpoint.manifest(path)["components"].values()
        expected = {f"{record['path']}/{file}" for record in components for file in record["files"]}
        missing = sorted(expected - present)
        return f"{missing[0]} is missing in it" if missing else None
    except _READ_ERRORS as error:
        return str(error) or type(error).__name__


def _force_to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
