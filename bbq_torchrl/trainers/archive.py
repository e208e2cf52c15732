"""Checkpoint archives, checked completely before anything in them is loaded.

An archive may contain anything. tensordict's loader trusts the metadata in it and unpickles by
default, which can run code. So an archive with any file that our checkpoints do not contain is
rejected. Only raw tensors and JSON as listed below are read, and :class:`TensorFiles` loads with
pickle disallowed.
"""

from __future__ import annotations

import json
import re
import zipfile
from typing import TYPE_CHECKING, Any

import tensordict
from tensordict import TensorDict
from torchrl.checkpoint import Checkpoint, StateDictCheckpointAdapter
from torchrl.checkpoint._checkpoint import _decode_state_dict_value

from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_COMPONENT = re.compile(r"components/\d{4}-[\w.%~-]+", re.ASCII)
_FILE = re.compile(r"state\.json|state/(meta\.json|tensor_\d{8}\.memmap)", re.ASCII)


class TensorFiles(StateDictCheckpointAdapter):
    """TorchRL's adapter for ``state_dict`` and ``load_state_dict``, with pickle disallowed."""

    def load(
        self,
        component: Any,
        path: Path,
        *,
        map_location: Any,
        tensor_load_kwargs: Mapping[str, Any],
        args: tuple[Any, ...],
        kwargs: Mapping[str, Any],
    ) -> None:
        """Restores a component from its folder; the arguments are TorchRL's."""
        del tensor_load_kwargs  # for torch.load only
        tensors = tensordict.load(path / self.state_directory, allow_pickle=False)
        schema = json.loads((path / self.schema_filename).read_text(encoding="utf-8"))
        state = _decode_state_dict_value(schema, tensors, map_location)
        component.load_state_dict(state, *args, **kwargs)


def read_archive(path: Path) -> dict[str, Any]:
    """Returns the manifest of an archive that is complete and contains known files only.

    Raises:
        FileNotFoundError: if the file does not exist.
        Exception: any other if the archive is damaged or foreign: ``ValueError``, or an error of
            zipfile, json or TorchRL.
    """
    with zipfile.ZipFile(path) as archive:
        size, limit = sum(info.file_size for info in archive.infolist()), path.stat().st_size
        if size > limit:  # ours are not compressed
            raise ValueError(f"its contents take {size} bytes, more than its size of {limit}")
        broken = archive.testzip()
        if broken is not None:
            raise ValueError(f"{broken} in it does not match its checksum")
        manifest = Checkpoint.manifest(path)
        rounds = manifest["metadata"]["round"]
        if type(rounds) is not int or rounds < 0:
            raise ValueError(f"its metadata name no round, but {shown(rounds)}")
        listed = ["manifest.json"]
        for name, record in manifest["components"].items():
            root, files = record["path"], record["files"]
            if record["adapter"] != TensorFiles.adapter_id or not _COMPONENT.fullmatch(root):
                raise ValueError(f"{name} in it is stored in no known way")
            listed += [f"{root}/{file}" for file in files]
            if foreign := [file for file in files if not _FILE.fullmatch(file)]:
                raise ValueError(f"{root}/{foreign[0]} in it belongs to no checkpoint")
            if json.loads(archive.read(f"{root}/state/meta.json"))["_type"] != str(TensorDict):
                raise ValueError(f"{root}/state/meta.json in it describes no tensors")
        names = archive.namelist()
        if sorted(names) != sorted(listed):
            file = min({*names} ^ {*listed}, default="a file that is there twice")
            raise ValueError(f"{file} is missing in it, or belongs to no checkpoint")
    return manifest
