"""Output of commands, and their exit codes where it cannot be written.

The reader of a pipe may have gone (``| head``), a disk may be full, a stream may be closed. Python
alone would end such a command in a traceback, or with another exit code.
"""

from __future__ import annotations

import argparse
import errno
import os
import sys
from contextlib import contextmanager, redirect_stdout, suppress
from functools import wraps
from io import StringIO, TextIOWrapper
from typing import TYPE_CHECKING, Any, ParamSpec

from bbq_torchrl.utils.text import sentence, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import TextIO

Given = ParamSpec("Given")

NOT_WRITTEN = 1
"""Exit code of a command whose standard output cannot be written."""

NO_READER = 141
"""Exit code of a command that nobody reads any more: that of a process which SIGPIPE ends."""


def write(text: str) -> None:
    """Prints what a command is asked for.

    Raises:
        SystemExit: it cannot be printed: :data:`NO_READER` without a word, else
            :data:`NOT_WRITTEN` after a sentence.
    """
    try:
        if sys.stdout is None:  # closed before Python started
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        escape()
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard(sys.stdout)
        sys.exit(NO_READER)
    except OSError as error:
        _discard(sys.stdout)
        print_error(f"error: standard output cannot be written: {sentence(error)}")
        sys.exit(NOT_WRITTEN)


def escape() -> None:
    """Escapes on standard output what its encoding lacks, such as ±, as standard error does."""
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def print_error(line: str) -> None:
    """Prints a line on standard error, if that can be: the exit code tells the same."""
    if sys.stderr is not None:
        try:
            sys.stderr.write(f"{line}\n")
            sys.stderr.flush()
        except OSError:
            _discard(sys.stderr)


def refusing(main: Callable[Given, int]) -> Callable[Given, int]:
    """Makes a command line end with a sentence and exit code 2 where an argument is wrong.

    That is a ValueError, an OSError, or a library of an extra that is not installed.
    """

    @wraps(main)
    def refused(*args: Given.args, **kwargs: Given.kwargs) -> int:
        try:
            return main(*args, **kwargs)
        except (ValueError, OSError, ModuleNotFoundError) as error:
            print_error(f"error: {sentence(error)}")
            return 2

    return refused


@contextmanager
def collected() -> Iterator[None]:
    """Collects what others print within it, and prints it by :func:`write`."""
    text = StringIO()
    try:
        with redirect_stdout(text):
            yield
    finally:
        write(text.getvalue())


def settle() -> None:
    """Lets go of what was logged to standard output and cannot be written: the work is done."""
    if sys.stdout is not None:
        try:
            sys.stdout.flush()
        except OSError:
            _discard(sys.stdout)


class Parser(argparse.ArgumentParser):
    """argparse's parser, whose help is printed by :func:`write`.

    Its description stays as it is: argparse would break the path of a page at a hyphen.
    """

    def __init__(self, **kwargs: Any) -> None:
        raw = argparse.RawDescriptionHelpFormatter
        super().__init__(**{"formatter_class": raw, **kwargs})

    def print_help(self, file: Any = None) -> None:
        """Prints the help, on standard output unless a file is given."""
        if file is None:
            write(self.format_help())
        else:
            super().print_help(file)


def between(kind: type[int] | type[float], low: float, high: float) -> Callable[[str], float]:
    """Returns what reads an argument that must be a number, ends included.

    Args:
        kind: ``int`` for a whole number, else ``float``.
        low: the least that is allowed.
        high: the most.
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


def _discard(stream: TextIO | None) -> None:
    """Sends what a stream still holds nowhere, so that Python's last flush finds no error."""
    if stream is not None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
