"""Checkpoints that survive kills, crashes and damaged disks.

A checkpoint is one :class:`torchrl.checkpoint.Checkpoint` archive, published by a rename: a ZIP
file with a file of ``torch.save`` for each component. TorchRL's ``CheckpointRotation`` silently
skips unreadable files, does not notice damaged tensors, and removes older checkpoints before the
new one is synced to disk. Here every byte is checked (by the ZIP's CRC-32) before anything is
loaded, a warning names a damaged file, and the previous checkpoint is used.

Files are loaded with ``weights_only``, and an archive with any other file is rejected, because
TorchRL would load other formats by unpickling, which can run code.

One process writes and any number may read: readers change nothing in the folder.
"""

from __future__ import annotations

import io
import logging
import os
import pickle
import re
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from textwrap import shorten
from typing import Any

import torch
from torchrl import torchrl_logger
from torchrl.checkpoint import Checkpoint, CheckpointError, StateDictCheckpointAdapter

_LOG = logging.getLogger(__name__)
_NAME = re.compile(r"round-(\d{6,})\.torchrl")
_REDUCED = "reduced"  # name of a reduced checkpoint until it replaces the full one


class TrainingError(ValueError):
    """An error that stops training or prevents resuming it; its message is for the user."""


class CheckpointDamagedError(TrainingError):
    """A run has no usable checkpoint, though it had one."""

    @classmethod
    def gone(cls, run_folder: Path) -> CheckpointDamagedError:
        """Returns the error for a started run without a checkpoint."""
        return cls(
            f"{run_folder} has metrics or a result, but no checkpoint to resume from: restore its "
            "checkpoint/, resume a copy of the folder that has it, or start a new run"
        )


class CheckpointMismatchError(TrainingError):
    """A checkpoint has another seed or configuration."""


class _TorchFile(StateDictCheckpointAdapter):
    """TorchRL's adapter for files of ``torch.save``, written by Python.

    Torch itself crashes on a full disk and cannot open every path.
    """

    def __init__(self) -> None:
        super().__init__("torch")

    def save(
        self, component: Any, path: Path, *, args: tuple[Any, ...], kwargs: Mapping[str, Any]
    ) -> None:
        """Saves a component's state into its folder; the arguments are TorchRL's."""
        content = io.BytesIO()
        torch.save(component.state_dict(*args, **kwargs), content)
        path.mkdir(parents=True)
        (path / self.state_torch).write_bytes(content.getbuffer())


class CheckpointFolder:
    """The last checkpoints of a run.

    Args:
        folder: the folder of the checkpoints, created by the first save.
        keep: the number of checkpoints to keep; None for all. Defaults to 2, so that one remains if
            the newest is damaged.
        **components: the objects to save and restore, by name, with ``state_dict`` and
            ``load_state_dict`` of tensors and plain values.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from torch import nn
        >>> with TemporaryDirectory() as folder:
        ...     saved = CheckpointFolder(Path(folder), network=nn.Linear(2, 1)).save(3, {"seed": 0})
        ...     path, fingerprint = CheckpointFolder(Path(folder)).newest()
        ...     print(path.name, fingerprint)
        round-000003.torchrl {'seed': 0}
    """

    def __init__(self, folder: Path, *, keep: int | None = 2, **components: Any) -> None:
        self.folder = folder
        self.keep = keep
        self._checkpoint = Checkpoint(format="archive")
        for name, component in components.items():
            self._checkpoint.register(name, component, adapter=_TorchFile())

    def save(
        self, rounds: int, config_fingerprint: Mapping[str, Any], *, name: str | None = None
    ) -> Path:
        """Saves all components, then removes older checkpoints, and returns the file.

        Args:
            rounds: the number of finished rounds.
            config_fingerprint: settings that the components depend on, JSON values by name.
            name: a file name outside the rotation. Defaults to None, the name of the round.

        Raises:
            OSError: if the folder is not writable or the disk is full.
        """
        path = self.folder / f"{name or f'round-{rounds:06d}'}.torchrl"
        self._checkpoint.save(path, metadata=dict(config_fingerprint))
        _fsync(path)
        _fsync(self.folder)
        if self.keep is not None:
            for old in self._files()[self.keep :]:
                old.unlink()
        return path

    def newest(
        self, config_fingerprint: Mapping[str, Any] | None = None, *components: str
    ) -> tuple[Path, dict[str, Any]] | None:
        """Returns the newest readable checkpoint and its fingerprint, or None without checkpoints.

        Nothing is loaded. A warning names damaged checkpoints.

        Args:
            config_fingerprint: settings that the checkpoint must have. Defaults to None: any.
            *components: the components that it must contain, in addition to the folder's.

        Raises:
            CheckpointDamagedError: if every checkpoint is damaged, or the newest readable one lacks
                a component.
            CheckpointMismatchError: if the checkpoint has another seed or configuration.
        """
        damages: list[str] = []
        for path in self._files():
            try:
                manifest = _read_manifest(path)
                saved = dict(manifest["metadata"])
            except Exception as error:  # damage can raise any kind
                if isinstance(error, FileNotFoundError) and not os.path.lexists(path):
                    # the writing process has saved a newer one
                    return self.newest(config_fingerprint, *components)
                reason = " ".join(str(error).split()) or type(error).__name__
                damages.append(f"{path.name}: {reason}")
                continue
            for damage in damages:
                _LOG.warning("checkpoint is damaged, using the previous one: %s", damage)
            parts = manifest["components"].keys()
            if missing := {*components, *self._checkpoint.components} - parts:
                raise CheckpointDamagedError(
                    f"the checkpoint {path} has no {', '.join(sorted(missing))}, only "
                    f"{', '.join(parts)}: to resume a run after its end, train it with "
                    "protocol.keep_checkpoints=last"
                )
            for name, value in (config_fingerprint or {}).items():
                if saved.get(name) != value:
                    raise CheckpointMismatchError(
                        f"{name} must be {saved.get(name)}, as in {path}, got {value}"
                    )
            return path, saved
        if damages:
            raise CheckpointDamagedError(
                f"every checkpoint in {self.folder} is damaged ({'; '.join(damages)}): restore "
                "a good one, or start a new run"
            )
        return None

    def restore(self, config_fingerprint: Mapping[str, Any] | None = None) -> int | None:
        """Restores all components from the checkpoint that :meth:`newest` finds.

        Args:
            config_fingerprint: as in :meth:`newest`, with the same errors.

        Returns:
            the number of finished rounds, or None without checkpoints.
        """
        found = self.newest(config_fingerprint)
        if found is None:
            return None
        path, _ = found
        try:
            self.load(path)
        except FileNotFoundError:
            if path.exists():
                raise
            return self.restore(config_fingerprint)  # the writing process has saved a newer one
        return _rounds_of(path)

    def load(self, path: Path) -> None:
        """Restores all components from a checkpoint that :meth:`newest` returned.

        Raises:
            CheckpointDamagedError: if it has more than tensors and plain values.
            CheckpointMismatchError: if it has another configuration.
        """

        # TorchRL warns of every other version; what no longer fits is an error below.
        def errors(record: logging.LogRecord) -> bool:
            return record.levelno >= logging.ERROR

        torchrl_logger.addFilter(errors)
        # Each component moves its state to its device, as the run may continue on a machine without
        # the device that the checkpoint was saved from.
        try:
            self._checkpoint.load(path, map_location="cpu")
        except CheckpointError as error:
            if isinstance(error.__cause__, pickle.UnpicklingError):
                raise CheckpointDamagedError(
                    f"the checkpoint {path} has more than tensors and plain values, so it is not "
                    "loaded: restore a good one, or start a new run"
                ) from error
            # The message may include whole networks; its beginning is enough.
            reason = shorten(str(error), 200, placeholder=" ...")
            raise CheckpointMismatchError(
                f"the checkpoint {path} is of another configuration: {reason}"
            ) from error
        finally:
            torchrl_logger.removeFilter(errors)

    def keep_only(self, *names: str) -> None:
        """Reduces the newest checkpoint to these components, which it loads; removes the others.

        Its name stays the same. Training cannot be resumed from it. A complete checkpoint exists at
        every moment.
        """
        parts = self._checkpoint.components
        named = {name: part for name, part in parts.items() if name in names}
        reduced = CheckpointFolder(self.folder, keep=None, **named)
        found = reduced.newest()
        if found is not None:
            path, fingerprint = found
            reduced.load(path)
            os.replace(reduced.save(0, fingerprint, name=_REDUCED), path)
            _fsync(self.folder)
            for other in self._files():
                if other != path:
                    other.unlink()

    def remove_leftovers(self) -> None:
        """Removes the leftovers of a process that was killed while saving.

        Only the writing process may call it, as another one would remove a save in progress.
        """
        for path in [*self.folder.glob(".*.torchrl.*"), *self.folder.glob(f"{_REDUCED}.torchrl")]:
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def _files(self) -> list[Path]:
        """Returns the checkpoints of finished rounds, newest first."""
        if not self.folder.is_dir():
            return []
        named = [path for path in self.folder.iterdir() if _NAME.fullmatch(path.name)]
        return sorted(named, key=_rounds_of, reverse=True)


def _rounds_of(path: Path) -> int:
    """Returns the number of finished rounds from the name of a checkpoint."""
    return int(path.stem.removeprefix("round-"))


def _read_manifest(path: Path) -> dict[str, Any]:
    """Returns the manifest of an archive that is undamaged and has nothing but torch's files.

    Raises:
        FileNotFoundError: if the file does not exist.
        Exception: any other if the archive is damaged or foreign.
    """
    with zipfile.ZipFile(path) as archive:
        if (broken := archive.testzip()) is not None:
            raise ValueError(f"{broken} in it does not match its checksum")
        manifest = Checkpoint.manifest(path)
        records = manifest["components"].values()
        file = _TorchFile.state_torch
        expected = ["manifest.json", *(f"{record['path']}/{file}" for record in records)]
        if sorted(archive.namelist()) != sorted(expected):
            raise ValueError("it lacks a file, or has one that belongs to no checkpoint")
        if any(record["files"] != [file] for record in records):
            raise ValueError("its manifest lists files that belong to no checkpoint")
    return manifest


def _fsync(path: Path) -> None:
    """Syncs a file, or the entries of a folder, to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
