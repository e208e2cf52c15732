"""Extras of the project: how they are installed here, their libraries, and a database address."""

from __future__ import annotations

import importlib
import json
import shlex
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parent.parent


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


def sqlite_url(file: Path) -> str:
    """Returns SQLAlchemy's address of a file, whatever characters its path has.

    A path that is put into such an address as it is leads elsewhere if it has a ``%``, ``#`` or
    ``?``. As a file URI it is read alike by SQLAlchemy 2.0, which leaves the name of a database as
    it is, and by 2.1, which quotes it.

    Args:
        file: an absolute path.

    Examples:
        >>> from pathlib import Path
        >>> sqlite_url(Path("/runs/a?b.db"))  # doctest: +ELLIPSIS
        'sqlite+pysqlite:///file...uri=true'
    """
    from sqlalchemy.engine import URL  # comes with Optuna and with MLflow

    # The driver is named because MLflow makes folders of an address that begins with "sqlite:///".
    url = URL.create("sqlite+pysqlite", database=file.as_uri(), query={"uri": "true"})
    return url.render_as_string()


def _origin() -> str:
    """Returns the URL that pip installed the project from, empty where that is an index."""
    try:
        recorded = distribution("bbq-torchrl").read_text("direct_url.json")
    except PackageNotFoundError:
        return ""
    return str(json.loads(recorded)["url"]) if recorded else ""
