"""Times that other work on the machine disturbs little: short blocks in turn, medians of ratios."""

from __future__ import annotations

import logging
import time
from contextlib import contextmanager
from statistics import median
from typing import TYPE_CHECKING, NamedTuple
from unittest.mock import patch

import torch

from bbq_torchrl.trainers import keep_freed_memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Block = Callable[[], float]
    """Does some work once and returns the seconds that a unit of it took."""

CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


class Comparison(NamedTuple):
    """A block of work beside another one, in one run.

    Attributes:
        seconds: median time of a unit of it.
        ratio: median of its times over those of its neighbors.
    """

    seconds: float
    ratio: float


class Timer:
    """Measures blocks of work by a clock.

    Args:
        clock: ``"wall"``, or ``"cpu"``, which other processes on the machine disturb less.
    """

    def __init__(self, clock: str = "wall") -> None:
        self.now = CLOCKS[clock]

    def time(self, work: Callable[[], object]) -> float:
        """Returns the seconds that ``work()`` took."""
        started = self.now()
        work()
        return self.now() - started


def interleaved(base: Block, candidate: Block, repeats: int) -> Comparison:
    """Runs base, candidate, base, candidate, ..., base, so that a slow spell hits both.

    Args:
        base: what the candidate is compared with.
        candidate: what is measured.
        repeats: how often the candidate runs.
    """
    bases, seconds = [base()], []
    for _ in range(repeats):
        seconds.append(candidate())
        bases.append(base())
    sides = zip(seconds, bases, bases[1:], strict=False)
    ratios = [2 * own / (before + after) for own, before, after in sides]
    return Comparison(median(seconds), median(ratios))


@contextmanager
def stopwatch(now: Callable[[], float], owner: object, name: str) -> Iterator[list[float]]:
    """Yields a list to which every call of ``owner.name`` within the context adds its seconds."""
    function, seconds = getattr(owner, name), []

    def timed(*args: object, **kwargs: object) -> object:
        started = now()
        try:
            return function(*args, **kwargs)
        finally:
            seconds.append(now() - started)

    with patch.object(owner, name, timed):
        yield seconds


@contextmanager
def one_thread() -> Iterator[None]:
    """Has a process measure as a run works: on one thread, keeping its memory, without a word."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    keep_freed_memory()
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage
    try:
        yield
    finally:
        torch.set_num_threads(threads)
