"""Names of a run's files, and atomic writing."""

from __future__ import annotations

import os
import re
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

CONFIG = "config.yaml"
"""The composed configuration."""

METRICS = "metrics.csv"
"""A row for each round and replica."""

CHECKPOINTS = "checkpoint"
"""The folder of checkpoints."""

RESULT = "result.json"
"""The final evaluation, of as many rounds as it says."""

CURVE = "curve.png"
"""The learning curve: the last file that a run writes."""

LOG = "train.log"
"""Messages, with times; Hydra writes it."""

HYDRA = ".hydra"
"""The folder in which Hydra notes what it composed."""

OVERRIDES = f"{HYDRA}/overrides.yaml"
"""The overrides of the command line; Hydra writes it."""

LOCK = ".lock"
"""The file that is locked; the file stays, the lock ends with its process."""

PROCESS = ".process"
"""The process that holds the lock; a killed one leaves the file behind."""


def folder_of(file: Path) -> Path:
    """Returns the run folder of a configuration or of metrics; Hydra's own lies a folder deeper."""
    return file.parent.parent if file.parent.name == HYDRA else file.parent


def numbers_in_order(folder: Path | str) -> list[tuple[bool, int, str]]:
    """Returns what sorts ``2_dqn`` before ``10_dqn``.

    Examples:
        >>> sorted(["10_dqn", "2_dqn"], key=numbers_in_order)
        ['2_dqn', '10_dqn']
    """
    parts = re.findall(r"\d+|\D+", str(folder))
    return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


def is_utf8(path: Path) -> bool:
    """Tells whether the name of a file is UTF-8, which torch and TensorBoard take every name for.

    A locale of another encoding has other names, and a name may be bytes that are no text.
    """
    return os.fsencode(path) == os.fspath(path).encode(errors="replace")


def write_text(path: Path, text: str, mode: int = 0o666) -> None:
    """Writes a file so that a reader, or a crash, finds the old text or the new, never a part.

    Args:
        path: of the file.
        text: its whole content.
        mode: who may read and write it, less what the umask takes.
    """
    write_bytes(path, text.encode(), mode)


def write_bytes(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Writes a file as :func:`write_text` does."""
    temporary = path.with_name(f".{path.name}.new")
    temporary.unlink(missing_ok=True)  # what a killed process left, or a link to another place
    opened = partial(os.open, mode=mode)
    with open(temporary, "xb", opener=opened) as file:  # O_CREAT | O_EXCL, which follows no link
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
