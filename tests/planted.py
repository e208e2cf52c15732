"""Checkpoints that somebody has changed, or put a pickle into: loading that makes a file."""

from __future__ import annotations

import json
import shutil
import zipfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import tensordict
from tensordict import NonTensorData, NonTensorStack, TensorDict

if TYPE_CHECKING:
    from collections.abc import Callable


class Payload:
    """Unpickling it touches a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def rewritten(archive: Path, change: Callable[[dict[str, bytes]], object]) -> None:
    """Changes the members of an archive and gives them the right checksums."""
    with zipfile.ZipFile(archive) as old:
        members = {name: old.read(name) for name in old.namelist()}
    change(members)
    with zipfile.ZipFile(archive, "w") as new:
        for name, content in members.items():
            new.writestr(name, content)


def plant(archive: Path, marker: Path, file: str) -> None:
    """Puts ``other.pickle`` or ``pickle.pkl`` where tensordict's loader finds it.

    The archive stays whole: every checksum is right, and the manifest lists every file.
    """
    rewritten(archive, partial(_put, marker, file, archive.parent / "planted"))


def _put(marker: Path, file: str, folder: Path, contents: dict[str, bytes]) -> None:
    manifest = json.loads(contents["manifest.json"])
    record = manifest["components"][min(manifest["components"])]
    node = (
        NonTensorData(Payload(marker))
        if file == "other.pickle"
        else NonTensorStack(*(NonTensorData(Payload(marker)) for _ in range(2)))
    )
    TensorDict({"planted": node}, batch_size=node.batch_size).memmap(folder)
    meta = f"{record['path']}/state/meta.json"
    described = json.loads(contents[meta])
    described["planted"] = json.loads((folder / "meta.json").read_text())["planted"]
    contents[meta] = json.dumps(described).encode()
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != "meta.json":
            contents[f"{record['path']}/state/{name}"] = path.read_bytes()
            record["files"].append(f"state/{name}")
    assert any(name.endswith(file) for name in contents)
    contents["manifest.json"] = json.dumps(manifest).encode()
    shutil.rmtree(folder)


def runs_code(archive: Path, folder: Path) -> None:
    """Loads what is planted in the way that nobody should."""
    with zipfile.ZipFile(archive) as file:
        file.extractall(folder)
    state = next(folder.glob("components/0000-*/state"))
    tensordict.load(state, allow_pickle=True)
