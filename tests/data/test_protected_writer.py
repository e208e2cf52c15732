"""The writer that protects first rows (test_replica_replay.py, too) and newest successes."""

import random

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from bbq_torchrl.data import ProtectedRoundRobinWriter


def make_buffer(capacity, *, protected=(), **keeping):
    writer = ProtectedRoundRobinWriter(**keeping)
    storage = LazyTensorStorage(capacity)
    buffer = TensorDictReplayBuffer(storage=storage, writer=writer, batch_size=1)
    if protected:
        buffer.extend(rows(*protected))
        buffer.writer.protect()
    return buffer


def rows(*values):
    return TensorDict(x=torch.tensor(values), batch_size=[len(values)])


def contents(buffer):
    return buffer[:]["x"].tolist()


@pytest.mark.parametrize("values", [(2, 3, 4), ()])
def test_more_rows_than_are_unprotected_and_none_are_refused(values):
    with pytest.raises(ValueError, match="extend"):
        make_buffer(4, protected=[0, 1]).extend(rows(*values))


@pytest.mark.parametrize("capacity", [9, 14, 40])
def test_the_newest_successes_are_overwritten_only_where_nothing_else_is_left(tmp_path, capacity):
    """Against slots that a hand writes one after the other, passing those of kept dialogues."""
    buffer = make_buffer(capacity, protected=[-2, -1], successes=2)
    dice, slots, hand, won = random.Random(capacity), [None] * (capacity - 2), 0, []
    for call in range(60):
        flat, new = [], []
        for number in range(10 * call, 10 * call + 3):
            turns, success = dice.randint(1, 2), call > 3 and dice.random() < 0.2
            flat += [(10 * number + turn, turn == turns - 1, success) for turn in range(turns)]
            new += [number] * success
        values, done, succeeded = zip(*flat, strict=True)
        index = buffer.extend(rows(*values))
        buffer.writer.mark(index, torch.tensor(succeeded), torch.tensor(done))
        if capacity == 9:  # too few for kept and new rows
            assert {-2, -1, *values} <= {*contents(buffer)}
            continue
        for value in values:
            while slots[hand] is not None and slots[hand] // 10 in won[-2:]:
                hand = (hand + 1) % len(slots)
            slots[hand], hand = value, (hand + 1) % len(slots)
        won += new
        assert contents(buffer) == [-2, -1, *(value for value in slots if value is not None)]
        if call % 20 == 0:
            buffer.writer.dumps(tmp_path)
            buffer.writer.loads(tmp_path)
        buffer.writer.load_state_dict(buffer.writer.state_dict())
    assert capacity == 9 or len(won) > 5
