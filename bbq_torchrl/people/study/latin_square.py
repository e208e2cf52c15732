"""The order in which participants meet agents: Williams rows, balanced for order and carry-over."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random


def williams_rows(count: int) -> list[list[int]]:
    """Returns orders of ``count`` treatments that are balanced for first-order carry-over.

    Williams (1949): each treatment occurs equally often in each place, and follows every other one
    equally often. There are ``count`` rows, twice as many for an odd count.

    Examples:
        >>> williams_rows(4)
        [[0, 1, 3, 2], [1, 2, 0, 3], [2, 3, 1, 0], [3, 0, 2, 1]]
        >>> len(williams_rows(3))
        6
    """
    first = [(place + 1) // 2 if place % 2 else -(place // 2) % count for place in range(count)]
    rows = [[(item + shift) % count for item in first] for shift in range(count)]
    return rows if count % 2 == 0 or count == 1 else rows + [row[::-1] for row in rows]


def assignments(
    place: int, agents: Sequence[str], goals: Sequence[int], sessions: int, seed: str
) -> list[tuple[str, int]]:
    """Returns the agent and goal of each session of the participant in a place of the design.

    Places run through blocks; a block has every Williams row once, in random order. With
    more sessions than agents, further rows follow. No goal occurs twice.

    Args:
        place: the place, from 0.
        agents: the agents' names.
        goals: numbers of the goals, at least as many as sessions.
        sessions: a multiple of the number of agents.
        seed: the random seed.
    """
    rows = williams_rows(len(agents))
    block, within = divmod(place, len(rows))
    order = Random(f"{seed} block {block}").sample(range(len(rows)), len(rows))
    repeats = range(sessions // len(agents))
    sequence = [item for repeat in repeats for item in rows[order[(within + repeat) % len(rows)]]]
    drawn = Random(f"{seed} place {place}").sample(list(goals), sessions)
    return [(agents[item], goal) for item, goal in zip(sequence, drawn, strict=True)]
