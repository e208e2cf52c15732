"""Rows that are told apart by their numbers, for the tests of the replay."""

from __future__ import annotations

import torch
from tensordict import TensorDict

KEYS = ["observation", ("next", "reward")]


def rows(first: int, count: int) -> TensorDict:
    numbers = torch.arange(first, first + count, dtype=torch.float32).unsqueeze(-1)
    return TensorDict(
        {"observation": numbers, "extra": numbers, "next": {"reward": 100 * numbers}}, [count]
    )
