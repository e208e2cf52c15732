"""Checkpoints that survive a kill, a crash and a damaged disk.

A checkpoint is one :class:`torchrl.checkpoint.Checkpoint` archive: a ZIP file of raw tensors and
JSON, published by a rename. What TorchRL's ``CheckpointRotation`` leaves open is done here:

- it skips files that it cannot read without a word, and does not notice a damaged tensor: here
  every byte is checked (the ZIP's CRC-32) before anything is loaded, a damaged file is named in a
  warning, and the one before it is used;
- its loader unpickles: here a file with anything but tensors and JSON is not loaded at all
  (:mod:`bbq_torchrl.trainers.archive`);
- nothing is forced to the disk: here the archive and its folder are, before older ones go;
- a process killed while it writes leaves its staging folder behind: here the next one removes it.

One process writes, any number may read: a reader changes nothing in the folder.
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
_METADATA_SIZE = 1 << 20  # bytes; more than the JSON and the folders of a checkpoint take
_KEPT = "kept"  # a smaller checkpoint, before it takes the place of the one that it is made of
_LEFTOVER = re.compile(rf"{_KEPT}\.torchrl|\..+\.torchrl\.(stage|archive|backup)-[0-9a-f]{{32}}")


class CheckpointFolder:
    """The last checkpoints of a run, the newest readable one first.

    Args:
        folder: where they lie; it is made when the first is saved.
        keep: how many are kept; None: all. Defaults to 2, so that one remains if the newest is
            damaged.
        **components: what is saved and restored, by name: objects with ``state_dict`` and
            ``load_state_dict``, of tensors and JSON values in dicts, lists and tuples.

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
        """Saves all components and returns the file; older checkpoints go once it is safe.

        Args:
            rounds: how many rounds are done.
            metadata: JSON values, read again without loading anything.
            name: a separate name, outside the rotation. Defaults to None, the round's.

        Raises:
            OSError: if the folder cannot be written or the disk has no room.
        """
        path = self.folder / f"{name or f'round-{rounds:06d}'}{_SUFFIX}"
        states = [part.state_dict() for part in self._checkpoint.components.values()]
        tensors = [leaf for leaf in pytree.tree_leaves(states) if isinstance(leaf, torch.Tensor)]
        # The tensors are written twice: staged and archived.
        _check_room(self.folder, 2 * sum(tensor.nbytes for tensor in tensors) + _METADATA_SIZE)
        with _openable_by_torch(self.folder) as folder:
            self._checkpoint.save(folder / path.name, metadata={"round": rounds, **metadata})
        _force_to_disk(path)
        _force_to_disk(self.folder)
        if self.keep is not None:
            for old in self._files()[self.keep :]:
                old.unlink()
        return path

    def newest(self) -> tuple[Path, dict[str, Any]] | None:
        """Returns the newest readable checkpoint and its metadata, or None without checkpoints.

        A damaged one is named in a warning.

        Raises:
            CheckpointDamagedError: if there are checkpoints, but every one is damaged, or the
                newest readable one lacks a component.
        """
        found, damages = self._newest(self._checkpoint.components)
        for damage in damages:
            _LOG.warning("checkpoint is damaged and not used: %s", damage)
        if found is not None and damages:
            _LOG.warning("taking the checkpoint before it: %s", found[0])
        return found

    def restore(self, expected: Mapping[str, Any]) -> tuple[Path, dict[str, Any]] | None:
        """Restores all components from the newest readable checkpoint; None without checkpoints.

        Args:
            expected: metadata that the checkpoint must have. What a checkpoint of an earlier
                version does not say is not compared.

        Returns:
            the file and its metadata.

        Raises:
            CheckpointDamagedError: as :meth:`newest`.
            CheckpointMismatchError: if the checkpoint is one of another seed or configuration.
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
            return self.restore(expected)  # the process that writes has saved a newer one
        return found

    def check(self, expected: Mapping[str, Any], *components: str) -> bool:
        """Refuses the newest readable checkpoint as :meth:`restore` would; whether there is one.

        Nothing is loaded, and nothing logged.

        Args:
            expected: as of :meth:`restore`.
            *components: what it must hold.

        Raises:
            CheckpointDamagedError: as :meth:`newest`.
            CheckpointMismatchError: if the checkpoint is one of another seed or configuration.
        """
        found, _ = self._newest(components)
        if found is not None:
            _compare(*found, expected)
        return found is not None

    def load(self, path: Path) -> None:
        """Restores all components from a checkpoint that :meth:`newest` returned.

        Raises:
            CheckpointMismatchError: if it was made by another configuration.
        """
        # Each part moves its state to its own device: the run may continue where the device that
        # it was saved from is absent.
        try:
            self._checkpoint.load(path, map_location="cpu")
        except CheckpointError as error:
            root: BaseException = error
            while root.__cause__ is not None:
                root = root.__cause__
            # What stands between may show whole networks; its beginning tells.
            reason = shorten(str(error), 200, placeholder=" ...")
            if "size" in str(root):
                reason = f"its networks have other shapes ({str(root).splitlines()[0]})"
            raise CheckpointMismatchError(
                f"the checkpoint {path} is of another configuration: {reason}"
            ) from error

    def keep_only(self, *names: str) -> None:
        """Leaves nothing but these components of the newest checkpoint; loads them on the way.

        It keeps its name. A training cannot go on from them. At every moment there is a whole
        checkpoint.
        """
        parts = self._checkpoint.components
        named = {name: part for name, part in parts.items() if name in names}
        kept = CheckpointFolder(self.folder, keep=None, **named)
        found = kept.restore({})
        if found is not None:
            path, metadata = found
            smaller = kept.save(metadata.pop("round"), metadata, name=_KEPT)
            os.replace(smaller, path)
            _force_to_disk(self.folder)
            for other in self._files():
                if other != path:
                    other.unlink()

    def remove_leftovers(self) -> None:
        """Removes what a process that was killed while saving left behind.

        Only for the process that writes: another one's would be what is just being saved.
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
        """Returns the newest readable checkpoint with its metadata, and which ones are damaged."""
        damages: list[str] = []
        for path in self._files():
            # An archive can be damaged in more ways than there are errors to name.
            try:
                manifest = read_archive(path)
                if (rounds := manifest["metadata"]["round"]) != _rounds_of(path):
                    raise ValueError(f"it is of round {shown(rounds)}")
            except Exception as error:
                if isinstance(error, FileNotFoundError) and not os.path.lexists(path):
                    return self._newest(components)  # the process that writes has saved a newer one
                reason = " ".join(str(error).split()) or type(error).__name__
                damages.append(f"{path.name}: {reason}")
                continue
            missing = set(components) - manifest["components"].keys()
            if missing:
                raise CheckpointDamagedError(
                    f"the checkpoint {path} has no {', '.join(sorted(missing))}, only "
                    f"{', '.join(manifest['components'])}: a run that is to go on after its "
                    "end needs protocol.keep_checkpoints=last"
                )
            return (path, dict(manifest["metadata"])), damages
        if damages:
            raise CheckpointDamagedError(
                f"every checkpoint in {self.folder} is damaged ({'; '.join(damages)}): put a good "
                "one back, or start a new run"
            )
        return None, []

    def _files(self) -> list[Path]:
        """Returns the checkpoints of finished rounds, the newest first."""
        if not self.folder.is_dir():
            return []
        named = [path for path in self.folder.iterdir() if _NAME.fullmatch(path.name)]
        return sorted(named, key=_rounds_of, reverse=True)


def _rounds_of(path: Path) -> int:
    """Returns how many rounds are done, as the name of a checkpoint says."""
    return int(path.name.removeprefix("round-").removesuffix(_SUFFIX))


def _compare(path: Path, metadata: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Raises CheckpointMismatchError for the first entry that is another one."""
    for name, value in expected.items():
        if name in metadata and metadata[name] != value:
            raise CheckpointMismatchError(
                f"{name} must be {metadata[name]}, as in the checkpoint {path}, got {value}"
            )


def _check_room(folder: Path, size: int) -> None:
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


@contextmanager
def _openable_by_torch(folder: Path) -> Iterator[Path]:
    """Makes a folder, and yields a path of it that torch can open.

    Torch takes every path for UTF-8. Where this one is not, it is the name in ASCII that Linux has
    for every folder that is open.
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


def _force_to_disk(path: Path) -> None:
    """Forces a file, or the names in a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
