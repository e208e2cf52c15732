"""Files: the names in a run folder, atomic writing, and YAML from untrusted sources."""

from __future__ import annotations

import csv
import errno
import io
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from bbq_torchrl.utils.text import sentence, shown

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
"""The lock file; it remains after its process has released the lock."""

PROCESS = ".process"
"""The process that has the lock; a killed process leaves this file behind."""


def folder_of(file: Path) -> Path:
    """Returns the run folder of a configuration or metrics file, also of Hydra's in a subfolder."""
    return file.parent.parent if file.parent.name == HYDRA else file.parent


def numbers_in_order(folder: Path | str) -> list[tuple[bool, int, str]]:
    """Returns a sort key that puts ``2_dqn`` before ``10_dqn``.

    Examples:
        >>> sorted(["10_dqn", "2_dqn"], key=numbers_in_order)
        ['2_dqn', '10_dqn']
    """
    parts = re.findall(r"\d+|\D+", str(folder))
    return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


def write_text(path: Path, text: str) -> None:
    """Writes a file atomically: readers, and a crash, leave the old or the new text, never a part.

    Every command writes its files by it. A symbolic link is replaced, its target stays as it is.

    Args:
        path: the file.
        text: its whole content.

    Raises:
        OSError: the file cannot be written, or is a device, pipe or folder.
    """
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Writes bytes as :func:`write_text` writes text."""
    if path.exists() and not path.is_file():  # root would replace /dev/null
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    temporary = path.with_name(f".{path.name}.new")
    temporary.unlink(missing_ok=True)  # left by a killed process, or a planted link
    with open(temporary, "xb") as file:  # O_CREAT | O_EXCL, which follows no link
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def csv_text(
    rows: Iterable[Mapping[str, object]], columns: Iterable[str], *, header: bool = True
) -> str:
    """Returns rows as CSV; a missing cell is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    if header:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


class _UniqueKeyLoader(yaml.SafeLoader):
    """A safe loader that refuses duplicate keys, where YAML takes the last value."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Returns the mapping of a node."""
        seen = set()
        for key_node, _ in node.value:
            if isinstance(key_node, yaml.ScalarNode) and key_node.value in seen:
                raise ValueError(
                    f"keys must be given once, got {shown(key_node.value)} again "
                    f"in line {key_node.start_mark.line + 1}"
                )
            seen.add(key_node.value if isinstance(key_node, yaml.ScalarNode) else None)
        return super().construct_mapping(node, deep=True)


def read_yaml(text: str) -> Any:
    """Parses YAML into mappings, lists, texts and numbers.

    Raises:
        ValueError: one sentence; it is not YAML, has a duplicate key, or is nested too deeply.

    Examples:
        >>> read_yaml("a: [1, b]")
        {'a': [1, 'b']}
    """
    try:
        return yaml.load(text, _UniqueKeyLoader)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise ValueError(f"it is not valid YAML: {error.problem}{line}") from error
    except (yaml.YAMLError, RecursionError, LookupError, TypeError, AttributeError) as error:
        # PyYAML's constructors of tags: !!int "" is an IndexError.
        raise ValueError(f"it is not valid YAML: {sentence(error)}") from error
