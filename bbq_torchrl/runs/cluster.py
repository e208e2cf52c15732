"""The head of a Ray cluster: a sweep that loses it ends with its table and a sentence.

Ray ends the process of a driver without a word to Python a minute after its head is gone.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from bbq_torchrl.utils import output

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PATIENCE = 45.0
"""Seconds without the head after which a sweep ends: less than Ray's minute."""

_POLL_SECONDS = 2.0
_LOST = 1  # exit code


@contextmanager
def watched_head(show: Callable[[], None], how_to_continue: Callable[[], str]) -> Iterator[None]:
    """In the context, this process ends with a sentence when Ray's head is gone.

    Args:
        show: prints the table of runs.
        how_to_continue: returns the state of the sweep, and the command that continues it.
    """
    is_over = threading.Event()

    def watch() -> None:
        seen = time.monotonic()
        while not is_over.wait(_POLL_SECONDS):
            if (head := _address()) is None or _answers(head):
                seen = time.monotonic()
            elif time.monotonic() - seen > PATIENCE:
                show()
                gone = f"error: the head of the Ray cluster, {head}, is gone"
                output.print_error(f"{gone}: {how_to_continue()} once it is back")
                os._exit(_LOST)

    threading.Thread(target=watch, name="ray-head", daemon=True).start()
    try:
        yield
    finally:
        is_over.set()


def _address() -> str | None:
    """Returns the head's address; None before the launcher has connected."""
    ray = sys.modules.get("ray")
    if ray is None or not hasattr(ray, "is_initialized") or not ray.is_initialized():
        return None
    address: str = ray.get_runtime_context().gcs_address
    return address


def _answers(address: str) -> bool:
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_POLL_SECONDS).close()
    except OSError:
        return False
    return True
