"""An epoch: each replica's transitions in an order of its own, cut into batches they share."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from tensordict import TensorDict

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tensordict import NestedKey, TensorDictBase
    from torch import Tensor
    from torchrl.data import TensorDictReplayBuffer
    from torchrl.envs import Transform

__all__ = ["Batch", "EpochMemory"]


class Batch(NamedTuple):
    """One mini-batch for every replica.

    Attributes:
        transitions: batch size [replicas, batch_size]; the entry ``valid`` [replicas, batch_size]
            tells the rows that count from the padding, which repeats a row of the same replica,
            and ``row_weight`` [replicas, batch_size] is one over their number, 0 for padding.
        active: for each replica, whether the batch holds a row of it that counts (on the host).
        active_mask: the same on the device, shape [replicas].
    """

    transitions: TensorDictBase
    active: tuple[bool, ...]
    active_mask: Tensor


class EpochMemory:
    """The memory that epochs are gathered into.

    It is kept: allocating 22 MB a replica (10,000 transitions of two observations of 268 floats)
    anew for every epoch costs as much as filling it.

    Args:
        buffers: of each replica; their samplers say in which order.
        keys: the entries that are stored.
        capacity: the most transitions of a buffer.
    """

    def __init__(
        self,
        buffers: Sequence[TensorDictReplayBuffer],
        keys: Sequence[NestedKey],
        capacity: int,
    ) -> None:
        self._buffers = buffers
        self._keys = keys
        self._capacity = capacity
        self._rows: TensorDict | None = None

    def gather(
        self,
        lengths: Sequence[int],
        batch_size: int,
        computed: Mapping[NestedKey, Tensor],
        transform: Transform | None,
    ) -> TensorDictBase:
        """Returns an epoch's rows, shuffled and padded: [replicas, batches, batch_size].

        Args:
            lengths: of the buffers.
            batch_size: rows of a batch for each replica.
            computed: values [replicas, rows, *] of every stored row, in the place of stored ones.
            transform: runs on the rows, which have the entry ``valid``.
        """
        batches = -(-max(lengths) // batch_size)
        padded = batches * batch_size
        memory = self._allocated(-(-self._capacity // batch_size) * batch_size, computed)
        for replica, (buffer, length) in enumerate(zip(self._buffers, lengths, strict=True)):
            index, _ = buffer.sampler.sample(buffer.storage, length)
            index = torch.cat([index, index[:1].expand(padded - length)])
            stored = buffer.storage.get(slice(0, length))
            target = memory[replica, :padded]
            for key in self._keys:
                if key not in computed:
                    torch.index_select(stored.get(key), 0, index, out=target.get(key))
            for key, values in computed.items():
                torch.index_select(values[replica], 0, index, out=target.get(key))
        rows = memory[:, :padded]
        # Filled in, not compared with the lengths: a tensor of them would have to be copied to the
        # device, and the host would wait for it.
        valid = torch.ones(rows.shape, dtype=torch.bool, device=buffer.storage.device)
        for replica, length in enumerate(lengths):
            valid[replica, length:].fill_(False)
        rows = rows.set("valid", valid)
        if transform is not None:
            rows = transform(rows)
        rows = rows.unflatten(1, (batches, batch_size))
        # Once for all batches: a few numbers a batch cost as much as a small matrix product.
        weight = rows["valid"].to(torch.get_default_dtype())
        tiny = torch.finfo(weight.dtype).tiny
        return rows.set("row_weight", weight / weight.sum(-1, keepdim=True).clamp_min_(tiny))

    def _allocated(self, rows: int, computed: Mapping[NestedKey, Tensor]) -> TensorDict:
        """Returns the memory for so many rows, batch size [replicas, rows]."""
        replicas, memory = len(self._buffers), self._rows
        if memory is None or memory.shape[1] != rows:
            row = self._buffers[0].storage.get(slice(0, 1)).select(*self._keys)
            memory = row.expand(replicas, rows).apply(torch.empty_like)
            assert isinstance(memory, TensorDict)
            self._rows = memory
        for key, values in computed.items():
            there = memory.get(key, None)
            if there is None or there.shape[2:] != values.shape[2:]:
                memory.set(key, values.new_empty((replicas, rows, *values.shape[2:])))
        return memory.select(*self._keys, *computed)
