"""The documentation's pages that commands name: in a wheel they are within the package."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


def page(name: str) -> Path:
    """Returns the file of a page.

    A wheel has the pages that ``pyproject.toml`` includes, a checkout has all.

    Args:
        name: path within docs/, without the ending.

    Examples:
        >>> page("chat").is_file()
        True
    """
    within = _PACKAGE / "docs" / f"{name}.md"
    return within if within.is_file() else _PACKAGE.parent / "docs" / f"{name}.md"
