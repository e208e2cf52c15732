"""Extras of the project: their libraries, and how they are added to it as it is installed here."""

from __future__ import annotations

import importlib
import json
import shlex
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parent


def install_command(extra: str) -> str:
    """Returns the command that installs an extra.

    A checkout is installed by its folder, and a wheel by its file: only a project that came from
    an index is found there by its name.

    Args:
        extra: its name, such as ``search``.
    """
    checkout = _PACKAGE.parent
    if (checkout / "pyproject.toml").is_file():
        return f"pip install -e {shlex.quote(f'{checkout}[{extra}]')}"
    origin = _origin()
    return f"pip install {shlex.quote(f'bbq-torchrl[{extra}]' + (origin and f' @ {origin}'))}"


@cache
def needed(package: str, module: str, extra: str = "language") -> Any:
    """Returns a module of an extra's library.

    Args:
        package: what pip calls the library.
        module: what is imported.
        extra: the extra that installs it.

    Raises:
        ModuleNotFoundError: if it is not installed, with the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"{package} is needed and not installed: {install_command(extra)}",
            name=error.name,
        ) from None


def _origin() -> str:
    """Returns the URL that pip installed the project from, empty where that is an index."""
    try:
        recorded = distribution("bbq-torchrl").read_text("direct_url.json")
    except PackageNotFoundError:
        return ""
    return str(json.loads(recorded)["url"]) if recorded else ""
