"""The writer that leaves the first rows alone."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer, TensorDictRoundRobinWriter

from bbq_torchrl.data import ProtectedRoundRobinWriter


def make_buffer(capacity: int, writer=None) -> TensorDictReplayBuffer:
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(capacity),
        writer=writer if writer is not None else ProtectedRoundRobinWriter(),
        batch_size=1,
    )


def rows(*values: int) -> TensorDict:
    return TensorDict({"x": torch.tensor(values)}, [len(values)])


def contents(buffer: TensorDictReplayBuffer) -> list[int]:
    return buffer[:]["x"].tolist()


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 5), st.lists(st.integers(1, 4), max_size=12))
def test_the_newest_rows_that_fit_are_kept_and_are_known_by_age(protected, sizes):
    buffer = make_buffer(9)
    if protected:
        buffer.extend(rows(*range(-protected, 0)))
        buffer.writer.protect()
    written = 0
    for size in sizes:
        buffer.extend(rows(*range(written, written + size)))
        written += size

    newest = list(range(max(0, written - (9 - protected)), written))
    if len(buffer):
        assert contents(buffer)[:protected] == list(range(-protected, 0))
        assert buffer.storage[buffer.writer.oldest_first()]["x"].tolist() == newest
    assert len(buffer) == protected + len(newest)


def test_without_protection_it_writes_as_torchrl_does():
    ours, theirs = make_buffer(7), make_buffer(7, TensorDictRoundRobinWriter())
    for start in range(0, 30, 3):
        indices = [b.extend(rows(start, start + 1, start + 2)) for b in (ours, theirs)]
        assert torch.equal(*indices)

    assert contents(ours) == contents(theirs)
    assert ours.write_count == theirs.write_count == 30


def test_single_rows_are_written_in_turn():
    buffer = make_buffer(3)
    buffer.extend(rows(1))
    buffer.writer.protect()

    indices = [int(buffer.add(TensorDict({"x": torch.tensor(x)}, []))) for x in (2, 3, 4)]

    assert indices == [1, 2, 1]
    assert contents(buffer) == [1, 4, 3]


def test_emptying_ends_the_protection():
    buffer = make_buffer(4)
    buffer.extend(rows(0, 1))
    buffer.writer.protect()

    buffer.empty()
    buffer.extend(rows(5, 6, 7, 8))

    assert contents(buffer) == [5, 6, 7, 8]
    assert buffer.writer.protected == 0


def test_more_rows_than_are_unprotected_are_refused():
    buffer = make_buffer(4)
    buffer.extend(rows(0, 1))
    buffer.writer.protect()

    with pytest.raises(ValueError, match=r"at most 2 rows at once \(capacity 4, 2 .*\), got 3"):
        buffer.extend(rows(2, 3, 4))
    with pytest.raises(ValueError, match="at least one row, got 0"):
        buffer.extend(rows())
    buffer.extend(rows(2, 3))
    with pytest.raises(ValueError, match="fewer than the capacity 4 of the storage, got 4"):
        buffer.writer.protect()
