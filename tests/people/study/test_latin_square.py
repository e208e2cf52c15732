"""The order in which people meet agents."""

from collections import Counter
from itertools import pairwise

import pytest

from bbq_torchrl.people.study.storage import assignments

AGENTS = {"a": 1, "ab": 2, "abc": 6, "abcd": 4, "abcde": 10, "abcdef": 6, "abcdefghij": 10}


@pytest.mark.parametrize("repeats", [1, 3])
@pytest.mark.parametrize("agents", AGENTS)
def test_in_a_block_each_agent_has_each_place_and_follows_each_other_equally_often(agents, repeats):
    size, count = AGENTS[agents], len(agents)
    for block in range(3):
        places = range(block * size, (block + 1) * size)
        plans = [assignments(n, list(agents), range(1, 51), count * repeats, "x") for n in places]
        for plan in plans:
            order = [agent for agent, _ in plan]
            rounds = {tuple(order[start : start + count]) for start in range(0, len(order), count)}
            assert len(rounds) == min(repeats, size)  # nobody has an order twice
            assert all(sorted(agents) == sorted(row) for row in rounds)
            assert len({goal for _, goal in plan}) == len(plan)
        first = [[agent for agent, _ in plan[:count]] for plan in plans]
        assert len(set(map(tuple, first))) == size
        for agents_there in zip(*first, strict=True):
            assert set(Counter(agents_there).values()) == {size // count}
        follows = Counter(pair for row in first for pair in pairwise(row))
        assert len(follows) == count * (count - 1)
        assert set(follows.values()) <= {size // count}
