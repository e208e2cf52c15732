"""YAML that somebody else may have written: plain values, each key once, no more than is there.

Every YAML file that comes from outside of the package is read here, or checked here before
OmegaConf reads it: aliases of aliases of aliases make a few lines stand for more values than memory
can hold.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Iterator

_MOST_VALUES = 10_000  # that aliases may make of a text; written out, there may be more


class _UniqueKeyLoader(yaml.SafeLoader):
    """A safe loader that refuses a key given twice, where YAML would let the last one win."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Returns the mapping that a node writes."""
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
    """Returns the mappings, lists, texts and numbers that a YAML text writes.

    Raises:
        ValueError: it is no YAML, gives a key twice, is nested too deeply, or its aliases stand for
            too much; one sentence.

    Examples:
        >>> read_yaml("a: [1, b]")
        {'a': [1, 'b']}
    """
    with _in_a_sentence():
        loader = _UniqueKeyLoader(text)
        node = _checked(loader)
        return None if node is None else loader.construct_document(node)


def check_yaml(text: str) -> None:
    """Refuses what :func:`read_yaml` refuses before it makes values of it.

    Raises:
        ValueError: as there; of tags and of keys nothing is said.
    """
    with _in_a_sentence():
        _checked(yaml.SafeLoader(text))


@contextmanager
def _in_a_sentence() -> Iterator[None]:
    try:
        yield
    except yaml.YAMLError as error:
        raise ValueError(f"it is not valid YAML: {_problem(error)}") from error
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except (LookupError, TypeError, AttributeError, OverflowError) as error:
        # What PyYAML's own readers of tags raise: !!int "" is an IndexError.
        raise ValueError("it is not valid YAML: a tag does not fit its value") from error


def _checked(loader: yaml.SafeLoader) -> yaml.Node | None:
    """Returns the node of a text, of which every alias has been counted."""
    node: yaml.Node | None = loader.get_single_node()
    if node is not None:
        counts: dict[int, int | None] = {}
        if _count(node, counts) - len(counts) > _MOST_VALUES:
            raise ValueError(
                f"its aliases make more than {_MOST_VALUES} values of it: write out what it is to "
                "say"
            )
    return node


def _count(node: yaml.Node, counts: dict[int, int | None]) -> int:
    """Returns how many values a node stands for, those of its aliases counted each time."""
    known = counts.get(id(node), 0)
    if known is None:
        raise ValueError(
            f"an alias in line {node.start_mark.line + 1} stands for what it is part of"
        )
    if not known:
        counts[id(node)] = None  # under way
        parts = node.value if isinstance(node, yaml.CollectionNode) else ()
        pairs = isinstance(node, yaml.MappingNode)
        inner = [part for pair in parts for part in pair] if pairs else parts
        known = counts[id(node)] = 1 + sum(_count(part, counts) for part in inner)
    return known


def _problem(error: yaml.YAMLError) -> str:
    """Returns what is wrong, and in which line."""
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return sentence(error)
    return f"{error.problem} in line {error.problem_mark.line + 1}"
