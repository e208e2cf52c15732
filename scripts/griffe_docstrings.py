"""A griffe extension: reads the docstrings as the package writes them, in TorchRL's manner.

TorchRL heads its doctests by "Example:", and a table is written as Sphinx reads it. griffe's
Google style knows "Examples:" only, and MkDocs tables in Markdown only.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension

_EXAMPLE = re.compile(r"^( *)Example:$", re.MULTILINE)
_RULE = re.compile(r"^ *=+(?: +=+)+ *$")


class Docstrings(Extension):
    """Rewrites every docstring before it is parsed."""

    def on_instance(self, *, obj: Any, **_: Any) -> None:
        """Takes in an object that griffe has read."""
        if obj.docstring is not None:
            text = _EXAMPLE.sub(r"\1Examples:", obj.docstring.value)
            obj.docstring.value = "\n".join(_with_markdown_tables(text.splitlines()))


def _with_markdown_tables(lines: list[str]) -> list[str]:
    """Returns the lines with every simple table of Sphinx's as a Markdown table."""
    rules = [number for number, line in enumerate(lines) if _RULE.match(line)]
    if not rules:
        return lines
    first, last = rules[0], rules[-1]
    columns = [match.span() for match in re.finditer(r"=+", lines[first])]
    starts = [start for start, _ in columns]
    ends = [*starts[1:], None]

    def row(line: str) -> str:
        cells = (line[start:end].strip() for start, end in zip(starts, ends, strict=True))
        return f"| {' | '.join(cells)} |"

    body = [number for number in range(first, last) if number not in rules]
    head, rest = (body[:1], body[1:]) if len(rules) > 2 else ([], body)
    table = [row(lines[head[0]]) if head else row(""), "|" + " --- |" * len(columns)]
    table += [row(lines[number]) for number in rest]
    return [*lines[:first], *table, *lines[last + 1 :]]
