"""The stored rows of replay buffers: a function of each, and all as a state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDict, lazy_stack

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from tensordict import NestedKey, TensorDictBase
    from torch import Tensor
    from torchrl.data import TensorDictReplayBuffer

__all__ = ["buffer_state", "load_buffer_state", "map_stored_rows"]

_ROWS_AT_ONCE = 512


@torch.no_grad()
def map_stored_rows(
    buffers: Sequence[TensorDictReplayBuffer],
    function: Callable[[TensorDictBase], Tensor],
    rows_at_once: int = _ROWS_AT_ONCE,
) -> Tensor:
    """Returns a function's values of every stored row, by place: shape [R, rows, *].

    All calls see batches of the same shape, so that what is computed for one replica's row does
    not depend, down to the last bit, on how many rows another has.

    Args:
        buffers: of R replicas, none of them empty.
        function: maps a TensorDict [R, rows_at_once] to a tensor [R, rows_at_once, *].
        rows_at_once: rows of a batch for each replica.

    Returns:
        the values; rows beyond a replica's own, up to the end of the last batch, mean nothing.
    """
    lengths = [len(buffer) for buffer in buffers]
    values = []
    for start in range(0, max(lengths), rows_at_once):
        rows = [
            _rows(buffer, start, min(start + rows_at_once, length), rows_at_once)
            for buffer, length in zip(buffers, lengths, strict=True)
        ]
        # lazily: only the entries that the function reads are copied side by side
        values.append(function(rows[0].unsqueeze(0) if len(rows) == 1 else lazy_stack(rows)))
    return torch.cat(values, 1)


def _rows(buffer: TensorDictReplayBuffer, start: int, stop: int, count: int) -> TensorDictBase:
    """Returns rows of a buffer from start to stop, and then its first row up to ``count``."""
    there = max(stop - start, 0)
    rows: TensorDictBase = buffer.storage.get(slice(start, start + there))
    if there == count:
        return rows
    first = buffer.storage.get(slice(0, 1)).expand(count - there)
    return first if there == 0 else TensorDict.cat([rows, first])


def buffer_state(buffer: TensorDictReplayBuffer, keys: Sequence[NestedKey]) -> dict[str, Any]:
    """Returns a buffer's entries by their flat names, each [rows, ...], and its writer's state."""
    rows: dict[str, Tensor] = {}
    if len(buffer):
        stored = buffer.storage.get(slice(0, len(buffer))).select(*keys)
        rows = dict(stored.flatten_keys("/").items())
    return {"rows": rows, "writer": buffer.writer.state_dict()}


def load_buffer_state(
    buffer: TensorDictReplayBuffer,
    state: Mapping[str, Any],
    capacity: int,
    device: torch.device,
) -> None:
    """Restores what :func:`buffer_state` returned, row for row in the same places.

    Raises:
        ValueError: if the rows are more than the capacity.
    """
    buffer.empty()
    if state["rows"]:
        rows = TensorDict(dict(state["rows"])).auto_batch_size_(1)
        if len(rows) > capacity:
            raise ValueError(f"the state must fit the capacity {capacity}, got {len(rows)} rows")
        buffer.extend(rows.unflatten_keys("/").to(device))
    buffer.writer.load_state_dict(state["writer"])
