"""Choices from uniform numbers in [0, 1)."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

Draws = Mapping[str, Any]


def choose_index(u: float, count: int) -> int:
    """Returns the index below `count` that the uniform `u` selects."""
    return math.floor(u * count)


def choose_slot(candidates: Collection[str], u: Sequence[float], slots: Sequence[str]) -> str:
    """Returns the candidate with the largest uniform, the first of them in slot order on a tie."""
    best = None
    for number, slot in enumerate(slots):
        if slot in candidates and (best is None or u[number] > u[slots.index(best)]):
            best = slot
    if best is None:
        raise ValueError("there is no slot to choose from")
    return best
