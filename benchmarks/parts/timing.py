"""Times that other work on the machine disturbs little: short blocks in turn, medians of ratios."""

from __future__ import annotations

import time
from collections import Counter
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    Block = Callable[[], float]
    """Does some work once and returns the seconds that a unit of it took."""

CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


class Comparison(NamedTuple):
    """Two blocks of work in one run.

    Attributes:
        seconds: median time of a unit of the candidate.
        base: median time of a unit of what it is compared with.
        ratio: median of candidate / base, each candidate beside its neighbors.
    """

    seconds: float
    base: float
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
    return Comparison(median(seconds), median(bases), median(ratios))


class Stopwatch:
    """Adds up the seconds spent in functions, by what they are for.

    Args:
        now: the clock.
    """

    def __init__(self, now: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: Counter[str] = Counter()
        self._now = now
        self._originals: list[tuple[object, str, Callable]] = []

    def watch(self, owner: object, name: str, what: str) -> None:
        """Replaces ``owner.name`` by a function that does the same and is timed."""
        function: Callable = getattr(owner, name)
        self._originals.append((owner, name, function))

        def timed(*args: object, **kwargs: object) -> object:
            started = self._now()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds[what] += self._now() - started

        setattr(owner, name, timed)

    def restore(self) -> None:
        """Puts the functions back."""
        while self._originals:
            owner, name, function = self._originals.pop()
            setattr(owner, name, function)
