"""Times that are robust to other load: short alternating blocks, medians of ratios."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from statistics import median
from time import perf_counter, process_time
from typing import TYPE_CHECKING, NamedTuple
from unittest.mock import patch

import torch

from bbq_torchrl.trainers.learn import keep_freed_memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Block = Callable[[], float]
    """Does some work once and returns the seconds per unit."""


class Comparison(NamedTuple):
    """A block of work compared with another one in the same run.

    Attributes:
        seconds: median time of a unit of it.
        ratio: median of its times over those of its neighbors.
    """

    seconds: float
    ratio: float


def seconds(work: Callable[[], object]) -> float:
    """Returns the seconds that ``work()`` took."""
    started = perf_counter()
    work()
    return perf_counter() - started


def cpu_seconds(work: Callable[[], object]) -> float:
    """Returns the CPU seconds that ``work()`` took: its seconds on an idle core."""
    started = process_time()
    work()
    return process_time() - started


def interleaved(base: Block, candidate: Block, repeats: int) -> Comparison:
    """Runs base, candidate, base, candidate, ..., base, so that a slow period affects both.

    Args:
        base: what the candidate is compared with.
        candidate: what is measured.
        repeats: how often the candidate runs.
    """
    bases, own = [base()], []
    for _ in range(repeats):
        own.append(candidate())
        bases.append(base())
    sides = zip(own, bases, bases[1:], strict=False)
    ratios = [2 * took / (before + after) for took, before, after in sides]
    return Comparison(median(own), median(ratios))


@contextmanager
def stopwatch(owner: object, name: str) -> Iterator[list[float]]:
    """Yields a list to which every call of ``owner.name`` within the context adds its seconds."""
    function, took = getattr(owner, name), []

    def timed(*args: object, **kwargs: object) -> object:
        started = perf_counter()
        try:
            return function(*args, **kwargs)
        finally:
            took.append(perf_counter() - started)

    with patch.object(owner, name, timed):
        yield took


def one_thread() -> None:
    """Prepares a process as for a run: one thread, memory kept by the allocator, no messages."""
    torch.set_num_threads(1)
    keep_freed_memory()
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it logs every storage
