"""The writer that protects the first rows; test_replica_replay.py checks which rows stay."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer, TensorDictRoundRobinWriter

from bbq_torchrl.data import ProtectedRoundRobinWriter


def make_buffer(capacity, writer=ProtectedRoundRobinWriter, *, protected=()):
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(capacity), writer=writer(), batch_size=1
    )
    if protected:
        buffer.extend(rows(*protected))
        buffer.writer.protect()
    return buffer


def rows(*values):
    return TensorDict(x=torch.tensor(values), batch_size=[len(values)])


def contents(buffer):
    return buffer[:]["x"].tolist()


def test_until_rows_are_protected_it_is_torchrls():
    ours, theirs = make_buffer(9), make_buffer(9, TensorDictRoundRobinWriter)
    for buffer in (ours, theirs):
        for first, count in ((0, 4), (4, 4), (8, 3), (11, 1), (12, 7)):
            buffer.extend(rows(*range(first, first + count)))
    assert contents(ours) == contents(theirs)
    assert ours.write_count == theirs.write_count == 19


def test_single_rows_are_written_in_turn():
    buffer = make_buffer(3, protected=[1])
    indices = [int(buffer.add(TensorDict(x=torch.tensor(x)))) for x in (2, 3, 4)]
    assert indices == [1, 2, 1]
    assert contents(buffer) == [1, 4, 3]


@pytest.mark.parametrize("values", [(2, 3, 4), ()])
def test_more_rows_than_are_unprotected_and_none_are_refused(values):
    with pytest.raises(ValueError, match="extend"):
        make_buffer(4, protected=[0, 1]).extend(rows(*values))


def test_a_buffer_written_to_disk_protects_the_same_rows(tmp_path):
    written, read = make_buffer(4, protected=[1, 2]), make_buffer(4)
    written.extend(rows(3))
    written.dumps(tmp_path)
    read.loads(tmp_path)
    for buffer in (written, read):
        buffer.extend(rows(4, 5))
    assert contents(read) == contents(written) == [1, 2, 5, 4]
