"""Output of commands, and their exit codes when it cannot be written.

The reader of a pipe may have left (``| head``), the disk may be full, or a stream closed. Python by
itself would print a traceback, or return another exit code. A message names the command that
installs what is missing, and the page that explains.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, wraps
from importlib.metadata import PackageNotFoundError, distribution
from io import TextIOWrapper
from pathlib import Path
from typing import Any, ParamSpec, TextIO

from bbq_torchrl.utils import interruption
from bbq_torchrl.utils.text import sentence, shown

_PACKAGE = Path(__file__).resolve().parent.parent

Given = ParamSpec("Given")

REFUSED = 2
"""Exit code of a command that an error of the user ended."""

NOT_WRITTEN = 1
"""Exit code when standard output cannot be written."""

NO_READER = 141
"""Exit code when the reader of a pipe has left, as after SIGPIPE."""


def write(text: str) -> None:
    """Prints the result of a command.

    Raises:
        SystemExit: the text cannot be printed: :data:`NO_READER` silently, or
            :data:`NOT_WRITTEN` after a message.
    """
    try:
        escape()
        sys.stdout.write(text)
        sys.stdout.flush()
    except OSError as error:
        _discard(sys.stdout)
        if isinstance(error, BrokenPipeError):
            sys.exit(NO_READER)
        print_error(f"error: standard output cannot be written: {sentence(error)}")
        sys.exit(NOT_WRITTEN)


def escape() -> None:
    """Makes standard output escape characters that its encoding lacks, as standard error does."""
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def print_error(line: str) -> None:
    """Prints a line to standard error, if possible."""
    if sys.stderr is None:  # closed before Python started
        return
    try:
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
    except OSError:
        _discard(sys.stderr)


def _discard(stream: TextIO) -> None:
    """Redirects a stream to nowhere, so that Python's last flush does not fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def refusals() -> Iterator[None]:
    """In the context, an error of the user prints one sentence and exits with code 2.

    Such errors are ValueError, OSError and the missing library of an extra.
    """
    try:
        yield
    except (ValueError, OSError, ModuleNotFoundError) as error:
        print_error(f"error: {sentence(error)}")
        sys.exit(REFUSED)


def refusing(main: Callable[Given, int]) -> Callable[Given, int]:
    """Decorates a command: :func:`refusals`, with the exit code returned.

    After a signal it prints the line of :mod:`~bbq_torchrl.utils.interruption`.
    """

    @wraps(main)
    def refused(*args: Given.args, **kwargs: Given.kwargs) -> int:
        try:
            with refusals():
                return main(*args, **kwargs)
        except interruption.Interrupted:
            print_error(interruption.line())
            return interruption.exit_code()
        except SystemExit as end:
            if end.code != REFUSED:
                raise
            return REFUSED

    return refused


class Parser(argparse.ArgumentParser):
    """argparse's parser with help printed by :func:`write`, and the description left as written.

    argparse would break the path of a page at a hyphen.
    """

    def __init__(self, **kwargs: Any) -> None:
        raw = argparse.RawDescriptionHelpFormatter
        super().__init__(**{"formatter_class": raw, **kwargs})

    def print_help(self, file: Any = None) -> None:
        """Prints the help to standard output."""
        write(self.format_help())


def between(kind: type[int] | type[float], low: float, high: float) -> Callable[[str], float]:
    """Returns the ``type`` of an argparse argument: a number from ``low`` to ``high``.

    Args:
        kind: ``int`` for a whole number, else ``float``.
        low: the minimum.
        high: the maximum.
    """

    def number(text: str) -> float:
        with suppress(ValueError):
            if low <= (value := kind(text)) <= high:
                return value
        name = "a whole number" if kind is int else "a number"
        raise argparse.ArgumentTypeError(
            f"must be {name} between {low} and {high}, got {shown(text)}"
        )

    return number


def page(name: str) -> Path:
    """Returns the file of a documentation page.

    A wheel has the pages that ``pyproject.toml`` includes, a checkout has all.

    Args:
        name: the path in docs/ without the suffix.

    Examples:
        >>> page("people").is_file()
        True
    """
    within = _PACKAGE / "docs" / f"{name}.md"
    return within if within.is_file() else _PACKAGE.parent / "docs" / f"{name}.md"


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
