"""Validation, sampling and batching of the rows of replay buffers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, lazy_stack
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer


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
