"""Ctrl-C and SIGTERM: a command ends with one line that says how far it is and how to continue.

A training ends after the round under way, with a checkpoint of it (:func:`on_interrupt`). A second
signal ends it at once, and so does the first one where there is nothing to save. Every file of a
run is written so that a process can die at any moment: it ends without unwinding, and so without a
traceback out of some import. This module imports nothing that takes time.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, ClassVar, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LOOKS_EVERY = 0.5  # seconds
_ORPHANED = 1  # the exit code of a worker that nobody waits for any more


class Interrupted(BaseException):
    """Raised where a signal has stopped the work in good order; :func:`line` says how far it is."""


class _State:
    """State of the signal handler of this process."""

    received: int | None = None
    stop: Callable[[], None] | None = None
    ends_with_parent = False

    where: ClassVar[Callable[[], str]] = staticmethod(lambda: "while starting")
    how: ClassVar[Callable[[], str]] = staticmethod(lambda: "the same command starts again")


def listen() -> None:
    """Makes Ctrl-C and SIGTERM end this process with a line, unless something else handles them."""
    # Python's process that clears away semaphores would add a warning to the line.
    quiet, others = "ignore:resource_tracker:UserWarning", os.environ.get("PYTHONWARNINGS", "")
    if quiet not in others:
        os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [others, quiet]))
    for number in _SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, _handle)


def end_with_parent() -> None:
    """Ends a worker of a sweep as soon as the process that started it has ended.

    A parent that is killed (SIGKILL, out of memory) stops no worker: it would train for nobody, and
    keep the same command out of its run folder. Elsewhere, and once it is so, it does nothing.
    """
    parent = multiprocessing.parent_process()
    if parent is None or _State.ends_with_parent:
        return
    _State.ends_with_parent = True

    def watch() -> None:
        while os.getppid() == parent.pid:
            time.sleep(_LOOKS_EVERY)
        os._exit(_ORPHANED)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


def tell(
    where: Callable[[], str] | None = None, how_to_go_on: Callable[[], str] | None = None
) -> None:
    """Says what the line at the end is made of.

    Args:
        where: how far the work is, such as ``"after 16 of 25 rounds"``.
        how_to_go_on: such as ``"python train.py resume=runs/x continues it"``.
    """
    _State.where = where or _State.where
    _State.how = how_to_go_on or _State.how


def line() -> str:
    """Returns what the command ends by."""
    return f"interrupted {_State.where()}: {_State.how()}"


@contextmanager
def on_interrupt(stop: Callable[[], None]) -> Iterator[None]:
    """Calls ``stop`` at the first signal within it, after which :func:`check` raises.

    Args:
        stop: makes the work end by itself.
    """
    before, _State.stop = _State.stop, stop
    try:
        yield
    finally:
        _State.stop = before


def exit_code() -> int:
    """Returns what a command ends with that a signal has stopped; 0 where none has come."""
    return 0 if _State.received is None else 128 + _State.received


def check() -> None:
    """Raises Interrupted if a signal has come."""
    if _State.received is not None:
        raise Interrupted


def _handle(number: int, frame: FrameType | None) -> None:
    first, _State.received = _State.received is None, _State.received or number
    if first and _State.stop is not None:
        _State.stop()
        if _on_terminal():
            _say("\nstopping after this round; once more: at once\n")
    elif multiprocessing.parent_process() is None:
        _end()
    elif _State.stop is None:
        # A worker of a sweep: it must not vanish, which would end the other jobs with it.
        raise Interrupted


def _end() -> NoReturn:
    for worker in multiprocessing.active_children():
        if worker.pid is not None:  # joblib's processes have no kill()
            with suppress(ProcessLookupError):
                os.kill(worker.pid, signal.SIGKILL)
    start = "\n" if _on_terminal() else ""  # a progress bar may stand in the line
    _say(f"{start}{line()}\n")
    os._exit(exit_code())


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _say(text: str) -> None:
    """Writes past all that Python may just be doing; where it cannot, the exit code tells."""
    if sys.stderr is not None:
        with suppress(OSError):
            os.write(sys.stderr.fileno(), text.encode())
