"""What the understanding knows of English: the words and the ways to write of ``english.yaml``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

ENGLISH: dict[str, Any] = yaml.safe_load(
    Path(__file__).with_name("english.yaml").read_text(encoding="utf-8")
)
"""The entries of the file by name."""


def word_set(name: str) -> frozenset[str]:
    """Returns the words of an entry that is written as ``"word word"``."""
    return frozenset(ENGLISH[name].split())


def pairs(name: str) -> dict[str, str]:
    """Returns the pairs of an entry that is written as ``"word:other word:other"``."""
    return dict(pair.split(":") for pair in ENGLISH[name].split())
