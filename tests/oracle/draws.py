"""Choices from uniform numbers in [0, 1)."""

import math


def choose_index(u, count):
    """Returns the index below `count` that the uniform `u` selects."""
    return math.floor(u * count)


def choose_slot(candidates, u, slots):
    """Returns the candidate with the largest uniform, the first of them in slot order on a tie."""
    return max((slot for slot in slots if slot in candidates), key=lambda s: u[slots.index(s)])
