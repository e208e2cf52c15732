"""Files: the names in a run folder, atomic writing, and YAML from untrusted sources."""

from __future__ import annotations

import os
import re
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterator
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


def is_utf8(path: Path) -> bool:
    """Returns whether a file name is UTF-8, which torch and TensorBoard expect.

    Under another locale, and in names that are arbitrary bytes, it may not be.
    """
    return os.fsencode(path) == os.fspath(path).encode(errors="replace")


def write_text(path: Path, text: str, mode: int = 0o666) -> None:
    """Writes a file atomically: readers, and a crash, leave the old or the new text, never a part.

    Args:
        path: the file.
        text: its whole content.
        mode: the permissions, before the umask.
    """
    write_bytes(path, text.encode(), mode)


def write_bytes(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Writes bytes as :func:`write_text` writes text."""
    temporary = path.with_name(f".{path.name}.new")
    temporary.unlink(missing_ok=True)  # left by a killed process, or a planted link
    opened = partial(os.open, mode=mode)
    with open(temporary, "xb", opener=opened) as file:  # O_CREAT | O_EXCL, which follows no link
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


_MAX_VALUES = 10_000  # that aliases may expand to; a file without aliases may have more


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

    YAML files from outside the package are read here, or pass :func:`check_yaml` before OmegaConf
    reads them: a few lines of nested aliases can expand to more values than memory can hold.

    Raises:
        ValueError: one sentence; it is not YAML, has a duplicate key, is nested too deeply, or its
            aliases expand to too many values.

    Examples:
        >>> read_yaml("a: [1, b]")
        {'a': [1, 'b']}
    """
    with _one_sentence():
        loader = _UniqueKeyLoader(text)
        node = _checked(loader)
        return None if node is None else loader.construct_document(node)


def check_yaml(text: str) -> None:
    """Checks syntax, depth and aliases as :func:`read_yaml` does, but not tags and keys.

    Raises:
        ValueError: one sentence.
    """
    with _one_sentence():
        _checked(yaml.SafeLoader(text))


@contextmanager
def _one_sentence() -> Iterator[None]:
    try:
        yield
    except yaml.YAMLError as error:
        raise ValueError(f"it is not valid YAML: {_problem(error)}") from error
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except (LookupError, TypeError, AttributeError, OverflowError) as error:
        # Raised by PyYAML's constructors of tags: !!int "" is an IndexError.
        raise ValueError("it is not valid YAML: a tag does not fit its value") from error


def _checked(loader: yaml.SafeLoader) -> yaml.Node | None:
    """Returns the root node of a text; refuses too many aliased values."""
    node: yaml.Node | None = loader.get_single_node()
    if node is not None:
        counts: dict[int, int | None] = {}
        if _count(node, counts) - len(counts) > _MAX_VALUES:
            raise ValueError(
                f"its aliases expand to more than {_MAX_VALUES} values: write the values out"
            )
    return node


def _count(node: yaml.Node, counts: dict[int, int | None]) -> int:
    """Returns the number of values in a node, counting an alias each time it is used."""
    known = counts.get(id(node), 0)
    if known is None:
        raise ValueError(
            f"an alias in line {node.start_mark.line + 1} refers to a value that contains it"
        )
    if not known:
        counts[id(node)] = None  # under way
        parts = node.value if isinstance(node, yaml.CollectionNode) else ()
        pairs = isinstance(node, yaml.MappingNode)
        inner = [part for pair in parts for part in pair] if pairs else parts
        known = counts[id(node)] = 1 + sum(_count(part, counts) for part in inner)
    return known


def _problem(error: yaml.YAMLError) -> str:
    """Returns the problem and its line."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return sentence(error)
    return f"{error.problem} in line {error.problem_mark.line + 1}"
