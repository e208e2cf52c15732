"""What a checkpoint's archive holds, read to its last byte before anything in it is loaded.

An archive is whatever somebody put into it. tensordict's loader follows the metadata that it finds
and, by default, unpickles, which runs code. So an archive with anything that a checkpoint of ours
never holds is refused whole: only raw tensors and JSON of the kinds below are read, and
:class:`TensorFiles` loads with pickle disallowed.
"""

from __future__ import annotations

import json
import math
import re
import zipfile
from typing import TYPE_CHECKING, Any

import tensordict
import torch
from tensordict import TensorDict
from torchrl.checkpoint import Checkpoint, StateDictCheckpointAdapter
from torchrl.checkpoint._checkpoint import _decode_state_dict_value

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["TensorFiles", "read_archive"]

_MANIFEST = "manifest.json"
_SCHEMA = "state.json"
_METADATA = "state/meta.json"
_COMPONENT = re.compile(r"components/\d{4}-[\w.%~-]+", re.ASCII)
_TENSOR = re.compile(r"tensor_\d{8}", re.ASCII)
_TENSORDICT = {"shape": [], "device": "cpu", "_type": str(TensorDict)}
_DTYPES = {
    str(dtype): dtype.itemsize
    for dtype in (
        torch.bool,
        torch.uint8,
        torch.int8,
        torch.int16,
        torch.int32,
        torch.int64,
        torch.float16,
        torch.bfloat16,
        torch.float32,
        torch.float64,
    )
}
_VALUES = (bool, int, float, str, type(None))


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
        del tensor_load_kwargs  # torch.load's
        tensors = tensordict.load(path / self.state_directory, allow_pickle=False)
        schema = json.loads((path / self.schema_filename).read_text(encoding="utf-8"))
        state = _decode_state_dict_value(schema, tensors, map_location)
        component.load_state_dict(state, *args, **kwargs)


def read_archive(path: Path) -> dict[str, Any]:
    """Returns the manifest of an archive that is whole and holds nothing but what is known.

    Raises:
        FileNotFoundError: if there is no such file.
        Exception: any other where it is damaged or foreign; what zipfile, json and TorchRL raise
            for what they cannot read, and ``ValueError``.
    """
    with zipfile.ZipFile(path) as archive:
        broken = archive.testzip()
        if broken is not None:
            raise ValueError(f"{broken} in it does not match its checksum")
        sizes = {}
        for info in archive.infolist():
            if info.filename in sizes or info.compress_type != zipfile.ZIP_STORED:
                raise ValueError(f"{info.filename} in it is there twice, or compressed")
            sizes[info.filename] = info.file_size
        manifest = Checkpoint.manifest(path)
        if type(manifest["metadata"]["round"]) is not int:
            raise ValueError("its metadata name no round")
        expected = {_MANIFEST}
        for name, record in manifest["components"].items():
            root = record["path"]
            if record["adapter"] != TensorFiles.adapter_id or not _COMPONENT.fullmatch(root):
                raise ValueError(f"{name} in it is stored in no known way")
            expected |= {f"{root}/{file}" for file in record["files"]}
        for missing in sorted(expected - sizes.keys()):
            raise ValueError(f"{missing} is missing in it")
        for foreign in sorted(sizes.keys() - expected):
            raise ValueError(f"{foreign} in it belongs to no checkpoint")
        for record in manifest["components"].values():
            _check_component(archive, record, sizes)
    return manifest


def _check_component(
    archive: zipfile.ZipFile, record: Mapping[str, Any], sizes: Mapping[str, int]
) -> None:
    """Raises ValueError where a component is more or less than tensors and a tree of them."""
    root = record["path"]
    tensors = json.loads(archive.read(f"{root}/{_METADATA}"))
    for key, value in _TENSORDICT.items():
        if tensors.pop(key) != value:
            raise ValueError(f"{root}/{_METADATA} in it describes no tensors")
    known = {_SCHEMA, _METADATA}
    for name, entry in tensors.items():
        file = f"state/{name}.memmap"
        known.add(file)
        _check_tensor(f"{root}/{file}", name, entry, sizes.get(f"{root}/{file}", 0))
    for foreign in sorted(set(record["files"]) - known):
        raise ValueError(f"{root}/{foreign} in it belongs to no checkpoint")
    _check_tree(json.loads(archive.read(f"{root}/{_SCHEMA}")), tensors.keys(), root)


def _check_tensor(file: str, name: str, entry: Any, size: int) -> None:
    is_plain = (
        _TENSOR.fullmatch(name)
        and entry.keys() == {"device", "shape", "dtype", "is_nested"}
        and entry["is_nested"] is False
        and entry["dtype"] in _DTYPES
        and all(type(length) is int and length >= 0 for length in entry["shape"])
    )
    if not is_plain:
        raise ValueError(f"{file} in it is described as no tensor")
    if math.prod(entry["shape"]) * _DTYPES[entry["dtype"]] != size:
        raise ValueError(f"{file} in it is not of the size that its shape has")


def _check_tree(node: Any, tensors: Any, root: str) -> None:
    """Raises ValueError where a tree has a node that no ``state_dict`` of ours has."""
    kind = node["kind"]
    children: list[Any] = []
    if kind in ("dict", "ordered_dict"):
        children = [child for item in node["items"] for child in item]
        if "metadata" in node:  # torch's, of a module's state
            children.append(node["metadata"])
    elif kind in ("list", "tuple"):
        children = node["items"]
    elif kind == "torch_size":
        children = [{"kind": "value", "value": length} for length in node["items"]]
    else:
        is_tensor = kind == "tensor" and node["key"] in tensors
        is_value = kind == "value" and type(node["value"]) in _VALUES
        if not (is_tensor or is_value):
            raise ValueError(f"{root}/{_SCHEMA} in it holds a {kind}")
    for child in children:
        _check_tree(child, tensors, root)
