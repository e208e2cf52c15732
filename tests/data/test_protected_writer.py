"""The writer that leaves the first rows alone."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer, TensorDictRoundRobinWriter

from bbq_torchrl.data import ProtectedRoundRobinWriter


def make_buffer(capacity: int, writer=ProtectedRoundRobinWriter) -> TensorDictReplayBuffer:
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(capacity), writer=writer(), batch_size=1
    )


def rows(*values: int) -> TensorDict:
    return TensorDict({"x": torch.tensor(values)}, [len(values)])


def contents(buffer: TensorDictReplayBuffer) -> list[int]:
    return buffer[:]["x"].tolist()


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 5), st.lists(st.integers(1, 4), max_size=12))
def test_the_newest_rows_that_fit_are_kept_and_are_known_by_age(protected, sizes):
    ours, theirs = make_buffer(9), make_buffer(9, TensorDictRoundRobinWriter)
    if protected:
        ours.extend(rows(*range(-protected, 0)))
        ours.writer.protect()
    written = 0
    for size in sizes:
        for buffer in (ours, theirs):
            buffer.extend(rows(*range(written, written + size)))
        written += size

    newest = list(range(max(0, written - (9 - protected)), written))
    assert len(ours) == protected + len(newest)
    assert ours.write_count == protected + written
    if len(ours):
        assert contents(ours)[:protected] == list(range(-protected, 0))
        assert ours.storage[ours.writer.oldest_first()]["x"].tolist() == newest
    if sizes and not protected:
        assert contents(ours) == contents(theirs)


def test_single_rows_are_written_in_turn():
    buffer = make_buffer(3)
    buffer.extend(rows(1))
    buffer.writer.protect()

    indices = [int(buffer.add(TensorDict({"x": torch.tensor(x)}, []))) for x in (2, 3, 4)]

    assert indices == [1, 2, 1]
    assert contents(buffer) == [1, 4, 3]


def test_more_rows_than_are_unprotected_are_refused():
    buffer = make_buffer(4)
    buffer.extend(rows(0, 1))
    buffer.writer.protect()

    with pytest.raises(ValueError, match=r"at most 2 rows at once \(capacity 4, 2 .*\), got 3"):
        buffer.extend(rows(2, 3, 4))
    with pytest.raises(ValueError, match="at least one row, got 0"):
        buffer.extend(rows())


def test_a_buffer_written_to_disk_protects_the_same_rows(tmp_path):
    written, read = make_buffer(4), make_buffer(4)
    written.extend(rows(1, 2))
    written.writer.protect()
    written.extend(rows(3))
    written.dumps(tmp_path)

    read.loads(tmp_path)
    for buffer in (written, read):
        buffer.extend(rows(4, 5))

    assert contents(read) == contents(written) == [1, 2, 5, 4]
