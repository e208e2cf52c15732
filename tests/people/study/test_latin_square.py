"""The order in which people meet agents."""

from collections import Counter
from itertools import pairwise

import pytest

from bbq_torchrl.people.study.storage import assignments, williams_rows


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 7, 10])
def test_each_treatment_stands_in_each_place_and_follows_each_other_equally_often(count):
    rows = williams_rows(count)
    for place in range(count):
        assert len(set(Counter(row[place] for row in rows).values())) == 1
    assert all(sorted(row) == list(range(count)) for row in rows)
    follows = Counter(pair for row in rows for pair in pairwise(row))
    assert len(follows) == count * (count - 1)
    assert set(follows.values()) <= {len(rows) // count}


@pytest.mark.parametrize(("agents", "repeats"), [("abc", 1), ("abcd", 2), ("abcdef", 1), ("a", 3)])
def test_a_block_of_people_has_every_row_once(agents, repeats):
    size, sessions = len(williams_rows(len(agents))), len(agents) * repeats
    goals = range(1, 51)
    for block in range(3):
        plans = [
            assignments(place, list(agents), goals, sessions, "seed")
            for place in range(block * size, (block + 1) * size)
        ]
        first = {"".join(agent for agent, _ in plan[: len(agents)]) for plan in plans}
        assert len(first) == size
        for plan in plans:
            assert set(Counter(agent for agent, _ in plan).values()) == {repeats}
            assert len({goal for _, goal in plan}) == sessions
            order = "".join(agent for agent, _ in plan)
            rows = {order[start:][: len(agents)] for start in range(0, sessions, len(agents))}
            assert len(rows) == min(repeats, size)
