"""Checkpoints that survive kills, crashes and damaged disks.

A checkpoint is one :class:`torchrl.checkpoint.Checkpoint` archive: a ZIP file of raw tensors and
JSON, published by a rename. This module adds to TorchRL's ``CheckpointRotation``:

- TorchRL silently skips unreadable files and does not notice damaged tensors. Here every byte is
  checked (by the ZIP's CRC-32) before anything is loaded. A warning names a damaged file, and the
  previous checkpoint is used.
- TorchRL's loader unpickles. Here a file with anything but tensors and JSON is not loaded
  (:mod:`bbq_torchrl.trainers.archive`).
- TorchRL does not sync files to disk. Here the archive and its folder are synced before older
  checkpoints are removed.
- A process that is killed while it writes leaves a staging folder behind. The next one removes it.

One process writes and any number may read: readers change nothing in the folder.
"""

from __future__ import annotations

import errno
import logging
import os
import re
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import torch
from torch.utils import _pytree as pytree
from torchrl.checkpoint import Checkpoint, CheckpointError

from bbq_torchrl.trainers.archive import TensorFiles, read_archive
from bbq_torchrl.trainers.errors import CheckpointDamagedError, CheckpointMismatchError
from bbq_torchrl.utils.files import is_utf8
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

_LOG = logging.getLogger(__name__)
_SUFFIX = ".torchrl"
_NAME = re.compile(r"round-(\d{6,})\.torchrl")
_METADATA_SIZE = 1 << 20  # bytes, an upper bound for the JSON and folders of a checkpoint
_REDUCED = "kept"  # name of a reduced checkpoint until it replaces the full one
_LEFTOVER = re.compile(rf"{_REDUCED}\.torchrl|\..+\.torchrl\.(stage|archive|backup)-[0-9a-f]{{32}}")


class CheckpointFolder:
    """The last checkpoints of a run.

    Args:
        folder: the folder of the checkpoints, created by the first save.
        keep: the number of checkpoints to keep; None for all. Defaults to 2, so that one remains if
            the newest is damaged.
        **components: the objects to save and restore, by name, with ``state_dict`` and
            ``load_state_dict`` of tensors and JSON values in dicts, lists and tuples.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from torch import nn
        >>> with TemporaryDirectory() as folder:
        ...     saved = CheckpointFolder(Path(folder), network=nn.Linear(2, 1)).save(3, {"seed": 0})
        ...     path, metadata = CheckpointFolder(Path(folder)).newest()
        ...     print(path.name, metadata)
        round-000003.torchrl {'round': 3, 'seed': 0}
    """

    def __init__(self, folder: Path, *, keep: int | None = 2, **components: Any) -> None:
        self.folder = folder
        self.keep = keep
        self._checkpoint = Checkpoint(format="archive")
        for name, component in components.items():
            self._checkpoint.register(name, component, adapter=TensorFiles())

    def save(self, rounds: int, metadata: Mapping[str, Any], *, name: str | None = None) -> Path:
        """Saves all components, then removes older checkpoints, and returns the file.

        Args:
            rounds: the number of finished rounds.
            metadata: JSON values that can be read without loading the components.
            name: a file name outside the rotation. Defaults to None, the name of the round.

        Raises:
            OSError: if the folder is not writable or the disk is full.
        """
        path = self.folder / f"{name or f'round-{rounds:06d}'}{_SUFFIX}"
        states = [part.state_dict() for part in self._checkpoint.components.values()]
        tensors = [leaf for leaf in pytree.tree_leaves(states) if isinstance(leaf, torch.Tensor)]
        # The tensors are written twice, staged and archived.
        size = 2 * sum(tensor.nbytes for tensor in tensors) + _METADATA_SIZE
        _check_disk_space(self.folder, size)
        with _path_for_torch(self.folder) as folder:
            self._checkpoint.save(folder / path.name, metadata={"round": rounds, **metadata})
        _fsync(path)
        _fsync(self.folder)
        if self.keep is not None:
            for old in self._files()[self.keep :]:
                old.unlink()
        return path

    def newest(self) -> tuple[Path, dict[str, Any]] | None:
        """Returns the newest readable checkpoint and its metadata, or None without checkpoints.

        A warning names damaged checkpoints.

        Raises:
            CheckpointDamagedError: if every checkpoint is damaged, or the newest readable one lacks
                a component.
        """
        found, damages = self._newest(self._checkpoint.components)
        for damage in damages:
            _LOG.warning("checkpoint is damaged and not used: %s", damage)
        if found is not None and damages:
            _LOG.warning("using the previous checkpoint: %s", found[0])
        return found

    def restore(self, expected: Mapping[str, Any]) -> tuple[Path, dict[str, Any]] | None:
        """Restores all components from the newest readable checkpoint; None without checkpoints.

        Args:
            expected: metadata that the checkpoint must have. Entries that are missing in the
                checkpoint (of an earlier version) are not compared.

        Returns:
            the file and its metadata.

        Raises:
            CheckpointDamagedError: as in :meth:`newest`.
            CheckpointMismatchError: if the checkpoint has another seed or configuration.
        """
        found = self.newest()
        if found is None:
            return None
        path, metadata = found
        _compare(path, metadata, expected)
        try:
            self.load(path)
        except FileNotFoundError:
            if path.exists():
                raise
            return self.restore(expected)  # the writing process has saved a newer one
        return found

    def check(self, expected: Mapping[str, Any], *components: str) -> bool:
        """Checks the newest readable checkpoint like :meth:`restore`; returns whether one exists.

        Nothing is loaded or logged.

        Args:
            expected: as in :meth:`restore`.
            *components: the components that it must contain.

        Raises:
            CheckpointDamagedError: as in :meth:`newest`.
            CheckpointMismatchError: if the checkpoint has another seed or configuration.
        """
        found, _ = self._newest(components)
        if found is not None:
            _compare(*found, expected)
        return found is not None

    def load(self, path: Path) -> None:
        """Restores all components from a checkpoint that :meth:`newest` returned.

        Raises:
            CheckpointMismatchError: if it has another configuration.
        """
        # Each component moves its state to its device, as the run may continue on a machine without
        # the device that the checkpoint was saved from.
        try:
            self._checkpoint.load(path, map_location="cpu")
        except CheckpointError as error:
            root: BaseException = error
            while root.__cause__ is not None:
                root = root.__cause__
            # The message may include whole networks; its beginning is enough.
            reason = shorten(str(error), 200, placeholder=" ...")
            if "size" in str(root):
                reason = f"its networks have other shapes ({str(root).splitlines()[0]})"
            raise CheckpointMismatchError(
                f"the checkpoint {path} is of another configuration: {reason}"
            ) from error

    def keep_only(self, *names: str) -> None:
        """Reduces the newest checkpoint to these components, which it loads; removes the others.

        Its name stays the same. Training cannot be resumed from it. A complete checkpoint exists at
        every moment.
        """
        parts = self._checkpoint.components
        named = {name: part for name, part in parts.items() if name in names}
        reduced = CheckpointFolder(self.folder, keep=None, **named)
        found = reduced.restore({})
        if found is not None:
            path, metadata = found
            saved = reduced.save(metadata.pop("round"), metadata, name=_REDUCED)
            os.replace(saved, path)
            _fsync(self.folder)
            for other in self._files():
                if other != path:
                    other.unlink()

    def remove_leftovers(self) -> None:
        """Removes the leftovers of a process that was killed while saving.

        Only the writing process may call it, as another one would remove a save in progress.
        """
        if not self.folder.is_dir():
            return
        for path in self.folder.iterdir():
            if _LEFTOVER.fullmatch(path.name):
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()

    def _newest(
        self, components: Iterable[str]
    ) -> tuple[tuple[Path, dict[str, Any]] | None, list[str]]:
        """Returns the newest readable checkpoint with its metadata, and the damaged newer ones."""
        damages: list[str] = []
        for path in self._files():
            # Damage can raise any kind of error.
            try:
                manifest = read_archive(path)
                if (rounds := manifest["metadata"]["round"]) != _rounds_of(path):
                    raise ValueError(f"it is of round {shown(rounds)}")
            except Exception as error:
                if isinstance(error, FileNotFoundError) and not os.path.lexists(path):
                    return self._newest(components)  # the writing process has saved a newer one
                reason = " ".join(str(error).split()) or type(error).__name__
                damages.append(f"{path.name}: {reason}")
                continue
            missing = set(components) - manifest["components"].keys()
            if missing:
                raise CheckpointDamagedError(
                    f"the checkpoint {path} has no {', '.join(sorted(missing))}, only "
                    f"{', '.join(manifest['components'])}: to resume a run after its end, train it "
                    "with protocol.keep_checkpoints=last"
                )
            return (path, dict(manifest["metadata"])), damages
        if damages:
            raise CheckpointDamagedError(
                f"every checkpoint in {self.folder} is damaged ({'; '.join(damages)}): restore "
                "a good one, or start a new run"
            )
        return None, []

    def _files(self) -> list[Path]:
        """Returns the checkpoints of finished rounds, newest first."""
        if not self.folder.is_dir():
            return []
        named = [path for path in self.folder.iterdir() if _NAME.fullmatch(path.name)]
        return sorted(named, key=_rounds_of, reverse=True)


def _rounds_of(path: Path) -> int:
    """Returns the number of finished rounds from the name of a checkpoint."""
    return int(path.name.removeprefix("round-").removesuffix(_SUFFIX))


def _compare(path: Path, metadata: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Raises CheckpointMismatchError for the first entry that differs."""
    for name, value in expected.items():
        if name in metadata and metadata[name] != value:
            raise CheckpointMismatchError(
                f"{name} must be {metadata[name]}, as in the checkpoint {path}, got {value}"
            )


def _check_disk_space(folder: Path, size: int) -> None:
    """Raises OSError if a folder's disk lacks room for ``size`` bytes; creates the folder.

    TorchRL writes through memory maps: on a full disk these raise no error, but a signal kills the
    process.
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


@contextmanager
def _path_for_torch(folder: Path) -> Iterator[Path]:
    """Creates a folder and yields a path to it that torch can open.

    Torch requires UTF-8 paths. For any other path it is the ASCII name that Linux has for every
    open folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if is_utf8(folder):
        yield folder
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        yield Path(f"/proc/self/fd/{descriptor}")
    finally:
        os.close(descriptor)


def _fsync(path: Path) -> None:
    """Syncs a file, or the entries of a folder, to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
