"""How an extra is added to the project as it is installed here."""

from __future__ import annotations

import json
import shlex
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

__all__ = ["install_command"]

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


def _origin() -> str:
    """Returns the URL that pip installed the project from, empty where that is an index."""
    try:
        recorded = distribution("bbq-torchrl").read_text("direct_url.json")
    except PackageNotFoundError:
        return ""
    return str(json.loads(recorded)["url"]) if recorded else ""
