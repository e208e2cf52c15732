"""The rows of replay buffers: checked, drawn and gathered into batches."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from tensordict import TensorDict, lazy_stack
from torch import Tensor

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from tensordict import NestedKey, TensorDictBase
    from torch import Tensor
    from torchrl.data import TensorDictReplayBuffer


def validate_transitions(rows: TensorDictBase, *, name: str = "transitions") -> None:
    """Raises if a row could not be learned from; returns nothing otherwise.

    Every floating entry must be finite. Where the rows have an ``action_mask``, which must be bool,
    the action (an index, or one-hot) must be allowed by it; where they have ``("next",
    "action_mask")``, bool too, every row that is not terminated must have some legal next action.
    One synchronization with the device for all checks together.

    Args:
        rows: transitions in TorchRL's layout, batch size [rows].
        name: what the rows are called in the error message.

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
    """Returns whether each action (index, or one-hot [rows, N]) is legal, shape [rows]."""
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
            tells the rows that count from the padding, which repeats a row of the same replica.
        active: for each replica, whether the batch holds a row of it that counts (on the host).
    """

    transitions: TensorDictBase
    active: tuple[bool, ...]


def shuffled_indices(
    buffers: Sequence[TensorDictReplayBuffer], batch_size: int
) -> tuple[Tensor, Tensor]:
    """Returns the places of an epoch's rows in each buffer, shuffled, and which of them count.

    Args:
        buffers: of each replica; their samplers say in which order.
        batch_size: rows of a batch for each replica.

    Returns:
        places, int64, and validity, bool, both [replicas, batches * batch_size]. A buffer with
        fewer rows than the others is padded with a row of it, which does not count.
    """
    lengths = [len(buffer) for buffer in buffers]
    padded = -(-max(lengths) // batch_size) * batch_size
    indices = []
    for buffer, length in zip(buffers, lengths, strict=True):
        index, _ = buffer.sampler.sample(buffer.storage, length)
        indices.append(torch.cat([index, index[:1].expand(padded - length)]))
    # Filled in, not compared with the lengths: a tensor of them would have to be copied to the
    # device, and the host would wait for it.
    valid = torch.ones(len(lengths), padded, dtype=torch.bool, device=indices[0].device)
    for replica, length in enumerate(lengths):
        valid[replica, length:].fill_(False)
    return torch.stack(indices), valid


def repeated_indices(buffers: Sequence[TensorDictReplayBuffer], count: int) -> Tensor:
    """Returns the places of ``count`` rows of each buffer, pass after shuffled pass.

    Args:
        buffers: of each replica; their samplers say in which order.
        count: the number of rows, which may be more or fewer than a buffer has.

    Returns:
        int64, shape [replicas, count].
    """
    indices = []
    for buffer in buffers:
        length = len(buffer)
        passes = [
            buffer.sampler.sample(buffer.storage, length)[0] for _ in range(-(-count // length))
        ]
        indices.append(torch.cat(passes)[:count])
    return torch.stack(indices)


def gather_rows(
    buffers: Sequence[TensorDictReplayBuffer],
    keys: Sequence[NestedKey],
    indices: Tensor,
    valid: Tensor,
    computed: Mapping[NestedKey, Tensor],
) -> TensorDict:
    """Returns the rows at these places, batch size [replicas, rows].

    Args:
        buffers: of each replica.
        keys: the entries that are stored.
        indices: places in each buffer, int64, shape [replicas, rows].
        valid: the entry of that name, bool, shape [replicas, rows].
        computed: values [replicas, stored rows, *], in the place of stored ones.
    """
    stored = [buffer.storage.get(slice(0, len(buffer))) for buffer in buffers]
    rows = TensorDict({"valid": valid}, valid.shape)
    sources: dict[NestedKey, Sequence[Tensor] | Tensor] = {
        **{key: [own.get(key) for own in stored] for key in keys},
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
    """Returns a function's values of every stored row, by place: shape [R, rows, *].

    All calls see batches of the same shape, so that what is computed for one replica's row does
    not depend, down to the last bit, on how many rows another has.

    Args:
        buffers: of R replicas, none of them empty.
        function: maps a TensorDict [R, 512] to a tensor [R, 512, *].

    Returns:
        the values; rows beyond a replica's own, up to the end of the last batch, mean nothing.
    """
    values = [
        # lazily: only the entries that the function reads are copied side by side
        function(lazy_stack([_rows_from(start, buffer) for buffer in buffers]))
        for start in range(0, max(map(len, buffers)), _ROWS_AT_ONCE)
    ]
    return torch.cat(values, 1)


def _rows_from(start: int, buffer: TensorDictReplayBuffer) -> TensorDictBase:
    """Returns 512 rows of a buffer; its first row is in the place of those that it has not."""
    stop = max(start, min(start + _ROWS_AT_ONCE, len(buffer)))
    rows: TensorDictBase = buffer.storage.get(slice(start, stop))
    missing = _ROWS_AT_ONCE - len(rows)
    if not missing:
        return rows
    return TensorDict.cat([rows, buffer.storage.get(slice(0, 1)).expand(missing)])
