"""Comparison of run folders: metrics, weights and buffers, bit by bit."""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

from tiny import rows


@dataclass
class Reference:
    """An undisturbed run.

    Attributes:
        folder: its run folder.
        overrides: its command line, without the folder.
        seconds: of processor time that it took.
    """

    folder: Path
    overrides: tuple[str, ...]
    seconds: float


def state(folder):
    """Checksums of the newest checkpoint's content, without the metrics, which have times."""
    newest = max((folder / "checkpoint").glob("round-*.torchrl"))
    with zipfile.ZipFile(newest) as archive:
        parts = {
            info.filename: info.CRC
            for info in archive.infolist()
            if info.filename.startswith("components/") and "-metrics/" not in info.filename
        }
    assert any("-replay/" in name for name in parts)
    assert any("-loss/" in name for name in parts)
    return parts


def result(folder):
    """result.json without its time."""
    found = json.loads((folder / "result.json").read_text())
    del found["wall_seconds"]
    return found


def assert_same(folder, reference):
    """Asserts that the run has ended with the reference's results."""
    assert rows(folder / "metrics.csv") == rows(reference / "metrics.csv")
    assert state(folder) == state(reference)
    assert result(folder) == result(reference)
    assert (folder / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert not [path.name for path in (folder / "checkpoint").iterdir() if path.name[0] == "."]
