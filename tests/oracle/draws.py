"""Choices from uniform numbers in [0, 1)."""

import math


def choose_index(u, count):
    """Returns the index below `count` that the uniform `u` selects."""
    return math.floor(u * count)


def choose_slot(candidates, u, slots):
    """Returns the candidate with the largest uniform, the first of them in slot order on a tie."""
    best = None
    for number, slot in enumerate(slots):
        if slot in candidates and (best is None or u[number] > u[slots.index(best)]):
            best = slot
    if best is None:
        raise ValueError("there is no slot to choose from")
    return best
