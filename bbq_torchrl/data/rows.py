"""The rows of replay buffers: what may be stored, what is overwritten, and how they are read."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, lazy_stack
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer, TensorDictRoundRobinWriter


def validate_transitions(rows: TensorDictBase, *, name: str = "transitions") -> None:
    """Raises ValueError if a row is invalid.

    Every floating-point entry must be finite. If the rows have an ``action_mask``, it must be bool
    and allow the action (an index, or one-hot). If they have ``("next", "action_mask")``, it must
    be bool and allow an action in every row that is not terminated. All checks together synchronize
    with the device once.

    Args:
        rows: transitions in TorchRL's layout, batch size [rows].
        name: the name of the rows in the error message.

    Raises:
        ValueError: names the key, the first bad row and what is allowed.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> rows = TensorDict(
        ...     {
        ...         "action": torch.tensor([0, 1]),
        ...         "action_mask": torch.tensor([[True, False], [True, False]]),
        ...     },
        ...     [2],
        ... )
        >>> validate_transitions(rows)
        Traceback (most recent call last):
        ValueError: action of transitions must be allowed by action_mask, but row 1 is not
        (1 of 2 rows)
    """
    checks: dict[str, Tensor] = {}
    for key, value in rows.items(include_nested=True, leaves_only=True):
        label = key if isinstance(key, str) else "/".join(key)
        if label in ("action_mask", "next/action_mask") and value.dtype != torch.bool:
            raise ValueError(f"{label} of {name} must be bool, got {value.dtype}")
        if value.is_floating_point():
            finite = torch.isfinite(value)
            bad = ~(finite.flatten(1).all(-1) if finite.ndim > 1 else finite)
            checks[f"{label} of {name} must be finite"] = bad
    mask = rows.get("action_mask", None)
    if mask is not None:
        checks[f"action of {name} must be allowed by action_mask"] = ~_allowed(rows["action"], mask)
    next_mask = rows.get(("next", "action_mask"), None)
    if next_mask is not None:
        terminated = rows["next", "terminated"].reshape(len(rows))
        rule = f"next/action_mask of {name} must allow some action where the row is not terminated"
        checks[rule] = ~(next_mask.any(-1) | terminated)
    if not checks:
        return
    bad = torch.stack(list(checks.values()))
    if not bool(bad.any()):
        return
    for rule, wrong in zip(checks, bad, strict=True):
        count = int(wrong.sum())
        if count:
            first = int(wrong.int().argmax())
            raise ValueError(f"{rule}, but row {first} is not ({count} of {len(rows)} rows)")


def _allowed(action: Tensor, mask: Tensor) -> Tensor:
    """Returns whether each action (an index, or one-hot [rows, N]) is legal, shape [rows]."""
    if action.shape == mask.shape:
        chosen = action.bool()
        return (chosen.sum(-1) == 1) & (chosen & mask).any(-1)
    index = action.reshape(mask.shape[0], 1).long()
    inside = (index >= 0) & (index < mask.shape[-1])
    return (inside & mask.gather(-1, index.clamp(0, mask.shape[-1] - 1))).squeeze(-1)


_OWN = "protected.json"  # in the folder of TorchRL's writer


class ProtectedRoundRobinWriter(TensorDictRoundRobinWriter):
    """A first-in, first-out writer that keeps the first rows of the storage.

    Until :meth:`protect` is called, it behaves like TorchRL's
    :class:`~torchrl.data.TensorDictRoundRobinWriter`. Afterwards the rows in the storage at that
    moment are never overwritten, and new rows take turns in the remaining capacity. So a replay
    buffer *spiked* with the dialogues of a rule policy keeps them during all of training.

    Likewise the rows of the newest ``successes`` successful dialogues are skipped, as long as there
    are others to overwrite.

    Args:
        successes: the number of successful dialogues to keep. Defaults to 0.

    Attributes:
        protected: the number of rows, from the first, that are never overwritten.

    Raises:
        ValueError: if more rows are written at once than the unprotected capacity.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        >>> buffer = TensorDictReplayBuffer(
        ...     storage=LazyTensorStorage(4), writer=ProtectedRoundRobinWriter(), batch_size=1
        ... )
        >>> _ = buffer.extend(TensorDict({"x": torch.tensor([1, 2])}, [2]))
        >>> buffer.writer.protect()
        >>> for x in (3, 4, 5):
        ...     _ = buffer.extend(TensorDict({"x": torch.tensor([x])}, [1]))
        >>> buffer[:]["x"]
        tensor([1, 2, 5, 4])
    """

    def __init__(self, successes: int = 0) -> None:
        super().__init__()
        self.successes = successes
        self.protected = 0
        # of each row of the storage, the number of its dialogue among the successful ones, or 0
        self._success = torch.zeros(0, dtype=torch.int64)

    @property
    def unprotected_capacity(self) -> int:
        """The number of rows of the storage that are written in turns."""
        return int(self._storage.max_size) - self.protected

    def check_room(self) -> None:
        """Raises ValueError if the storage is full: protecting all rows would leave no room."""
        rows = len(self._storage)
        if rows >= self._storage.max_size:
            raise ValueError(
                f"protected rows must be fewer than the capacity {self._storage.max_size} of the "
                f"storage, got {rows}"
            )

    def protect(self) -> None:
        """Protects every row that is in the storage now.

        Raises:
            ValueError: as :meth:`check_room` does.
        """
        self.check_room()
        self.protected = self._cursor = len(self._storage)

    def add(self, data: TensorDictBase) -> torch.Tensor:
        """Writes one row and returns its index, shape []."""
        return self.extend(data.unsqueeze(0))[0]

    def extend(self, data: TensorDictBase) -> torch.Tensor:
        """Writes rows in turns and returns their indices, shape [rows]."""
        rows, room = len(data), self.unprotected_capacity
        if rows == 0:
            raise ValueError("extend needs at least one row, got 0")
        if rows > room:
            raise ValueError(
                f"extend writes at most {room} rows at once (capacity {self._storage.max_size}, "
                f"{self.protected} protected), got {rows}"
            )
        device = data.device if data.device is not None else "cpu"
        start = self._cursor - self.protected
        if self._success.any():
            turns = torch.arange(start, start + room) % room + self.protected
            number = self._success[turns]
            kept = number > max(0, int(self._success.max()) - self.successes)
            index = turns[kept.int().argsort(stable=True)[:rows]]
            self._success[index] = 0
            start = int(index[-1]) + 1 - self.protected - rows
            index = index.to(device)
        else:
            index = torch.arange(start, start + rows, device=device) % room + self.protected
        self._cursor = self.protected + (start + rows) % room
        self._write_count += rows
        data.set("index", index)
        self._storage.set(index, data)
        self._bump_generation(index, data)
        self._mark_update_entities(index)
        return index

    def mark(self, index: torch.Tensor, succeeded: torch.Tensor, done: torch.Tensor) -> None:
        """Marks rows of successful dialogues, which :meth:`extend` has just written.

        Args:
            index: their places in the storage, int64 [rows].
            succeeded: whether a row's dialogue succeeds, bool [rows].
            done: whether it ends with the row, bool [rows].
        """
        if self.successes and (succeeded := succeeded.cpu()).any():
            if not len(self._success):
                self._success = torch.zeros(self._storage.max_size, dtype=torch.int64)
            ends = (succeeded & done.cpu()).long()
            number = self._success.max() + 1 + ends.cumsum(0) - ends
            self._success[index.cpu()] = torch.where(succeeded, number, 0)

    def _empty(self, empty_write_count: bool = True) -> None:
        super()._empty(empty_write_count=empty_write_count)
        self.protected = 0
        self._success = self._success[:0]

    def state_dict(self) -> dict[str, Any]:
        """Returns the cursor, the numbers of written and protected rows, and the successes."""
        kept = {"_success": self._success} if self.successes else {}
        return {**super().state_dict(), "_protected": self.protected, **kept}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores the state from :meth:`state_dict`."""
        super().load_state_dict(state_dict)
        self.protected = state_dict["_protected"]
        self._success = state_dict.get("_success", self._success[:0]).clone()

    def dumps(self, path: Path | str) -> None:
        """Writes the state from :meth:`state_dict` into a folder."""
        super().dumps(path)
        own = {"protected": self.protected, "success": self._success.tolist()}
        (Path(path) / _OWN).write_text(json.dumps(own), encoding="utf-8")

    def loads(self, path: Path | str) -> None:
        """Restores the state written by :meth:`dumps`."""
        super().loads(path)
        own = json.loads((Path(path) / _OWN).read_text(encoding="utf-8"))
        self.protected = own["protected"]
        self._success = torch.tensor(own["success"], dtype=torch.int64)


_ROWS_AT_ONCE = 512


class Batch(NamedTuple):
    """One mini-batch for every replica.

    Attributes:
        transitions: batch size [replicas, batch_size]; the entry ``valid`` [replicas, batch_size]
            is False for padding, which repeats a row of the same replica.
        active: for each replica, whether the batch has a valid row of it (on the host).
    """

    transitions: TensorDictBase
    active: tuple[bool, ...]


def shuffled_indices(
    buffers: Sequence[TensorDictReplayBuffer], batch_size: int
) -> tuple[Tensor, Tensor]:
    """Returns the shuffled indices of an epoch's rows in each buffer, and their validity.

    Args:
        buffers: the buffers of each replica, whose samplers shuffle.
        batch_size: the number of rows per batch and replica.

    Returns:
        indices, int64, and validity, bool, both [replicas, batches * batch_size]. A buffer with
        fewer rows than the others is padded with one of its rows, marked invalid.
    """
    lengths = [len(buffer) for buffer in buffers]
    padded = -(-max(lengths) // batch_size) * batch_size
    indices = []
    for buffer, length in zip(buffers, lengths, strict=True):
        index, _ = buffer.sampler.sample(buffer.storage, length)
        indices.append(torch.cat([index, index[:1].expand(padded - length)]))
    # Filled in place: comparing with a tensor of lengths would copy it to the device, and the host
    # would wait for the copy.
    valid = torch.ones(len(lengths), padded, dtype=torch.bool, device=indices[0].device)
    for replica, length in enumerate(lengths):
        valid[replica, length:].fill_(False)
    return torch.stack(indices), valid


def gather_rows(
    buffers: Sequence[TensorDictReplayBuffer],
    keys: Sequence[NestedKey],
    indices: Tensor,
    valid: Tensor,
    computed: Mapping[NestedKey, Tensor],
) -> TensorDict:
    """Returns the rows at these indices, batch size [replicas, rows].

    Args:
        buffers: the buffers of each replica.
        keys: the stored entries.
        indices: indices into each buffer, int64, shape [replicas, rows].
        valid: the entry ``valid``, bool, shape [replicas, rows].
        computed: values [replicas, stored rows, *] that replace stored entries.
    """
    stored = [buffer.storage.get(slice(0, len(buffer))) for buffer in buffers]
    rows = TensorDict({"valid": valid}, valid.shape)
    sources: dict[NestedKey, Sequence[Tensor] | Tensor] = {
        **{key: [entries.get(key) for entries in stored] for key in keys},
        **computed,
    }
    for key, values in sources.items():
        entry = values[0].new_empty((*valid.shape, *values[0].shape[1:]))
        for replica, index in enumerate(indices):
            torch.index_select(values[replica], 0, index, out=entry[replica])
        rows.set(key, entry)
    return rows


@torch.no_grad()
def map_stored_rows(
    buffers: Sequence[TensorDictReplayBuffer], function: Callable[[TensorDictBase], Tensor]
) -> Tensor:
    """Returns a function's values for every stored row, by index: shape [R, rows, *].

    All calls get batches of the same shape, so the values of a replica's row do not depend, to the
    last bit, on how many rows another replica has.

    Args:
        buffers: the buffers of R replicas, not empty.
        function: maps a TensorDict [R, 512] to a tensor [R, 512, *].

    Returns:
        the values; those beyond the end of a replica's buffer are undefined.
    """
    values = [
        # lazily, so that only the entries that the function reads are stacked
        function(lazy_stack([_rows_from(start, buffer) for buffer in buffers]))
        for start in range(0, max(map(len, buffers)), _ROWS_AT_ONCE)
    ]
    return torch.cat(values, 1)


def _rows_from(start: int, buffer: TensorDictReplayBuffer) -> TensorDictBase:
    """Returns 512 rows of a buffer, padded with its first row."""
    stop = max(start, min(start + _ROWS_AT_ONCE, len(buffer)))
    rows: TensorDictBase = buffer.storage.get(slice(start, stop))
    missing = _ROWS_AT_ONCE - len(rows)
    if not missing:
        return rows
    return TensorDict.cat([rows, buffer.storage.get(slice(0, 1)).expand(missing)])
