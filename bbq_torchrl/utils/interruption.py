"""Ctrl-C and SIGTERM: a command ends with one line on its progress and how to continue.

A training finishes and saves the current round (:func:`on_interrupt`). A second signal ends it at
once, as does the first one when there is nothing to save. The process then exits without unwinding,
so no traceback comes out of an import; files are written so that this loses nothing. This module
imports nothing slow.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import ClassVar, NoReturn

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_POLL_SECONDS = 0.5
_ORPHANED = 1  # exit code of a worker whose parent is gone


class Interrupted(BaseException):
    """Raised after a signal has stopped the work; :func:`line` reports the progress."""


class _State:
    """State of the signal handler of this process."""

    received: int | None = None
    stop: Callable[[], None] | None = None
    ends_with_parent = False

    where: ClassVar[Callable[[], str]] = staticmethod(lambda: "while starting")
    how: ClassVar[Callable[[], str]] = staticmethod(lambda: "the same command starts again")


def listen() -> None:
    """Makes Ctrl-C and SIGTERM end this process with a line, unless they have other handlers."""
    # Python's resource tracker would print a warning after the line.
    quiet, others = "ignore:resource_tracker:UserWarning", os.environ.get("PYTHONWARNINGS", "")
    if quiet not in others:
        os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [others, quiet]))
    for number in _SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _handle)


def end_with_parent() -> None:
    """Ends a worker of a sweep when its parent process ends; does nothing outside a worker.

    A parent that is killed (SIGKILL, out of memory) stops no workers. They would train on, and keep
    the run folders locked.
    """
    parent = multiprocessing.parent_process()
    if parent is None or _State.ends_with_parent:
        return
    _State.ends_with_parent = True

    def watch() -> None:
        while os.getppid() == parent.pid:
            time.sleep(_POLL_SECONDS)
        os._exit(_ORPHANED)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


def tell(
    where: Callable[[], str] | None = None, how_to_continue: Callable[[], str] | None = None
) -> None:
    """Sets the parts of the line printed after a signal.

    Args:
        where: the progress, such as ``"after 16 of 25 rounds"``.
        how_to_continue: such as ``"python train.py resume=runs/x continues it"``.
    """
    _State.where = where or _State.where
    _State.how = how_to_continue or _State.how


def line() -> str:
    """Returns the last line of an interrupted command."""
    return f"interrupted {_State.where()}: {_State.how()}"


def stop_by(stop: Callable[[], None]) -> None:
    """Sets the function that the first signal calls, which lets the work end by itself."""
    _State.stop = stop


@contextmanager
def on_interrupt(stop: Callable[[], None]) -> Iterator[None]:
    """Calls ``stop``, which lets the work end by itself, at the first signal in the context.

    After the signal :func:`check` raises.
    """
    before, _State.stop = _State.stop, stop
    try:
        yield
    finally:
        _State.stop = before


def exit_code() -> int:
    """Returns the exit code of a command stopped by a signal; 0 before any signal."""
    return 0 if _State.received is None else 128 + _State.received


def check() -> None:
    """Raises :class:`Interrupted` after a signal."""
    if _State.received is not None:
        raise Interrupted


def exit_if_interrupted() -> None:
    """Prints the line and exits after a signal."""
    if _State.received is not None:
        _say(f"{line()}\n")
        sys.exit(exit_code())


def end() -> NoReturn:
    """Ends this process and its workers at once, with the line."""
    for worker in multiprocessing.active_children():
        if worker.pid is not None:  # joblib's processes have no kill()
            with suppress(ProcessLookupError):
                os.kill(worker.pid, signal.SIGKILL)
    start = "\n" if _on_terminal() else ""  # after a progress bar
    _say(f"{start}{line()}\n")
    os._exit(exit_code())


def _handle(number: int, frame: FrameType | None) -> None:
    first, _State.received = _State.received is None, _State.received or number
    if first and _State.stop is not None:
        _State.stop()
        if _on_terminal():
            _say("\nstopping after this round; once more: at once\n")
    elif multiprocessing.parent_process() is None:
        end()
    elif _State.stop is None:
        # A worker of a sweep: exiting here would end the other jobs with it.
        raise Interrupted


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _say(text: str) -> None:
    """Writes to standard error unbuffered, if possible; the exit code says the rest."""
    if sys.stderr is not None:
        with suppress(OSError):
            os.write(sys.stderr.fileno(), text.encode())
