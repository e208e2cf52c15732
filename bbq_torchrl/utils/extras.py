"""Extras of the project: the command that installs one, its modules, and the URL of SQLite."""

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

    It names the folder of a checkout, or the file of a wheel that was not installed from an index.

    Args:
        extra: the name, such as ``search``.
    """
    checkout = _PACKAGE.parent
    if (checkout / "pyproject.toml").is_file():
        return f"pip install -e {shlex.quote(f'{checkout}[{extra}]')}"
    origin = _origin()
    return f"pip install {shlex.quote(f'bbq-torchrl[{extra}]' + (origin and f' @ {origin}'))}"


@cache
def needed(package: str, module: str, extra: str = "language") -> Any:
    """Imports a module that an extra installs.

    Args:
        package: the library's name for pip.
        module: the module.
        extra: the extra.

    Raises:
        ModuleNotFoundError: it is missing; the message has the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"{package} is needed and not installed: {install_command(extra)}",
            name=error.name,
        ) from None


def sqlite_url(file: Path) -> str:
    """Returns SQLAlchemy's URL of an SQLite file, whatever characters its path has.

    A file URI escapes ``%``, ``#`` and ``?``. SQLAlchemy 2.0, which does not quote the name of a
    database, and 2.1, which does, read it alike.

    Args:
        file: an absolute path.

    Examples:
        >>> from pathlib import Path
        >>> sqlite_url(Path("/runs/a?b.db"))  # doctest: +ELLIPSIS
        'sqlite+pysqlite:///file...uri=true'
    """
    from sqlalchemy.engine import URL  # comes with Optuna and with MLflow

    # MLflow would create folders for a URL that begins with "sqlite:///".
    url = URL.create("sqlite+pysqlite", database=file.as_uri(), query={"uri": "true"})
    return url.render_as_string()


def _origin() -> str:
    """Returns the URL that pip installed the project from; empty for an index."""
    try:
        recorded = distribution("bbq-torchrl").read_text("direct_url.json")
    except PackageNotFoundError:
        return ""
    return str(json.loads(recorded)["url"]) if recorded else ""
