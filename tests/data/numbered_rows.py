"""Rows that are told apart by their numbers, for the tests of the replay."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from bbq_torchrl.data import ReplicaReplay

KEYS = ["observation", ("next", "reward")]


def rows(first: int, count: int) -> TensorDict:
    numbers = torch.arange(first, first + count, dtype=torch.float32).unsqueeze(-1)
    return TensorDict(
        {"observation": numbers, "extra": numbers, "next": {"reward": 100 * numbers}}, [count]
    )


def filled(*lengths: int, capacity: int = 2000, transform=None) -> ReplicaReplay:
    """A replay whose replica r holds so many rows, from number 10,000 r on."""
    replay = ReplicaReplay(capacity, replicas=len(lengths), keys=KEYS, transform=transform)
    replay.extend([rows(10_000 * r, length) for r, length in enumerate(lengths)])
    return replay


def stored(replay: ReplicaReplay, replica: int) -> list[int]:
    return replay.buffers[replica][:]["observation"][:, 0].int().tolist()
