"""Markdown tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[object]], *, numbers: int = 0) -> str:
    r"""Returns a Markdown table.

    Args:
        head: the column names.
        rows: the cells; a pipe in one is escaped.
        numbers: how many columns, the last ones, are aligned to the right.

    Examples:
        >>> print(table(("agent", "success"), [("a|b", 0.5)], numbers=1))
        | agent | success |
        | --- | ---: |
        | a\|b | 0.5 |
    """
    words = len(head) - numbers
    lines = [list(head), ["---"] * words + ["---:"] * numbers]
    lines += [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
