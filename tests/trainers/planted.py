"""Checkpoints that somebody has put a pickle into; loading it makes a file."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import tensordict
from tensordict import NonTensorData, NonTensorStack, TensorDict


class Payload:
    """Unpickling it touches a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


def plant(archive: Path, marker: Path, file: str) -> None:
    """Puts ``other.pickle`` or ``pickle.pkl`` where tensordict's loader finds it.

    The archive stays whole: every checksum is right, and the manifest lists every file.
    """
    with zipfile.ZipFile(archive) as old:
        contents = {name: old.read(name) for name in old.namelist()}
    manifest = json.loads(contents["manifest.json"])
    record = manifest["components"][min(manifest["components"])]
    node = (
        NonTensorData(Payload(marker))
        if file == "other.pickle"
        else NonTensorStack(*(NonTensorData(Payload(marker)) for _ in range(2)))
    )
    folder = archive.parent / "planted"
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
    with zipfile.ZipFile(archive, "w") as new:
        for name, content in contents.items():
            new.writestr(name, content)
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()


def runs_code(archive: Path, folder: Path) -> None:
    """Loads what is planted in the way that nobody should."""
    with zipfile.ZipFile(archive) as file:
        file.extractall(folder)
    state = next(folder.glob("components/0000-*/state"))
    tensordict.load(state, allow_pickle=True)
