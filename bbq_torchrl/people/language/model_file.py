"""The file of an understander: numpy's format, without pickles, checked before anything uses it.

A C library reads the tagger and trusts its input, so a file is used only if its checksum is right.
That detects damage, not malice: whoever can write the file can write its checksum.
"""

from __future__ import annotations

import hashlib
import io
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from bbq_torchrl.people.language.confidence import CUES
from bbq_torchrl.settings import TEXTS
from bbq_torchrl.utils.files import write_bytes
from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

VERSION = 8

_ARRAYS = {
    "about": (np.uint8, 1),
    "tagger": (np.uint8, 1),
    "bag": (np.float16, 2),
    "heads": (np.float32, 2),
    "bias": (np.float32, 1),
    "calibration": (np.float64, 1),
    "checksum": (np.uint8, 1),
}
"""Name -> type and number of dimensions of each array."""

_TEXTS = ("acts", "slots", "features", "known")

_MAX_BYTES = 1 << 28  # of all arrays: a hundred times the size of ours


def write_model(path: Path, about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Writes a file atomically.

    Args:
        path: the file.
        about: JSON values: ``domain``, ``threshold`` and the lists ``acts``, ``slots``,
            ``features`` and ``known``.
        arrays: ``tagger``, ``bag``, ``heads``, ``bias`` and ``calibration``.
    """
    text = json.dumps({"version": VERSION, **about}, ensure_ascii=False).encode()
    whole = {"about": np.frombuffer(text, dtype=np.uint8), **arrays}
    buffer = io.BytesIO()
    # Not allow_pickle=False: NumPy 1.26 would store it as one more array.
    np.savez_compressed(buffer, **whole, checksum=_checksum(whole))  # type: ignore[arg-type]
    write_bytes(path, buffer.getvalue())


def read_model(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Returns the arguments of :func:`write_model`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is damaged, or of another version.
    """
    try:
        # Opened here, since numpy leaves a damaged file open.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            size = sum(info.file_size for info in stored.zip.infolist())
            if size > _MAX_BYTES:
                raise ValueError(f"it would take {size} bytes, more than {_MAX_BYTES}")
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(arrays["about"].tobytes())
        version = about["version"]
    except FileNotFoundError:
        raise
    except Exception as error:
        reason = sentence(error) or type(error).__name__
        raise ValueError(f"{path} is no file of an understander, or damaged: {reason}") from None
    if version != VERSION:
        raise ValueError(f"{path} must be of version {VERSION}, got {version!r}: train it anew")
    fault = _fault(about, arrays)
    if fault is not None:
        raise ValueError(f"{path} is no file of an understander, or damaged: {fault}")
    return about, arrays


def _fault(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> str | None:
    """Returns the fault of a file's content, if there is one."""
    if arrays.keys() != _ARRAYS.keys():
        return f"it must have the arrays {', '.join(_ARRAYS)}, got {shown(sorted(arrays))}"
    for name, (kind, dimensions) in _ARRAYS.items():
        array = arrays[name]
        if array.dtype != kind or array.ndim != dimensions:
            of = f"{np.dtype(kind)} of {dimensions} dimensions"
            return f"{name} must be {of}, got {array.dtype} of {array.ndim}"
    checksum = arrays.pop("checksum")
    if not np.array_equal(checksum, _checksum(arrays)):
        return "its checksum is wrong"
    if len(arrays["calibration"]) != CUES or not np.isfinite(arrays["calibration"]).all():
        return f"calibration must be {CUES} finite numbers"
    for name in _TEXTS:
        if fault := TEXTS.fault(name, about.get(name)):
            return fault
    if len(arrays["bag"]) != len(about["features"]):
        return f"bag must have a row for each feature, got {len(arrays['bag'])}"
    threshold = about.get("threshold")
    if not isinstance(about.get("domain"), str) or not isinstance(threshold, int | float):
        return "it must have the name of a domain, and a threshold"
    return None


def _checksum(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Returns the SHA-256 of arrays with their names, types and shapes, as bytes [32]."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return np.frombuffer(digest.digest(), dtype=np.uint8)
