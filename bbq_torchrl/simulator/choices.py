"""Choices by index, rows of tables, and sets of records as bits.

Nothing here draws. The uniform numbers come from the environment's generator, so equal numbers give
equal choices.
"""

from __future__ import annotations

import torch
from torch import Tensor


def index_below(uniform: Tensor, count: Tensor | int) -> Tensor:
    """Chooses an index below ``count``, ``floor(uniform * count)``. Returns long, same shape.

    Args:
        uniform: float32 in [0, 1).
        count: the number of choices, at least 0; 0 gives 0.

    Examples:
        >>> index_below(torch.tensor([0.0, 0.49, 0.99]), 2)
        tensor([0, 0, 1])
    """
    # In float32 the product can round up to count itself.
    return (uniform.double() * count).long()


def pick_slot(pool: Tensor, uniform: Tensor) -> Tensor:
    """Chooses a slot of each set with equal probability. Returns one-hot flags, bool ``[*B, S]``.

    The slot with the largest number wins; ties go to the lowest slot. An empty set has no flag.

    Args:
        pool: bool ``[*B, S]``, the slots to choose from.
        uniform: float32 ``[*B, S]`` in [0, 1).

    Examples:
        >>> pick_slot(torch.tensor([True, False, True]), torch.tensor([0.2, 0.9, 0.3]))
        tensor([False, False,  True])
    """
    return one_hot(torch.where(pool, uniform, -1.0).argmax(-1), pool.shape[-1]) & pool


def one_hot(index: Tensor, count: int) -> Tensor:
    """Returns one-hot flags of an index, bool ``[*B, count]``; a negative index has no flag.

    Examples:
        >>> one_hot(torch.tensor([1, -1]), 3)
        tensor([[False,  True, False],
                [False, False, False]])
    """
    return index[..., None] == torch.arange(count, device=index.device)


def rows(table: Tensor, index: Tensor) -> Tensor:
    """Returns ``table[index]``, shape ``[*B, *row]``.

    On the CPU this copies whole rows, about five times as fast as advanced indexing.

    Args:
        table: ``[n, *row]``.
        index: long ``[*B]``, in [0, n).

    Examples:
        >>> rows(torch.tensor([[1, 2], [3, 4]]), torch.tensor([1, 0, 1]))
        tensor([[3, 4],
                [1, 2],
                [3, 4]])
    """
    return table.index_select(0, index.reshape(-1)).view(*index.shape, *table.shape[1:])


WORD_BITS = 64
_BYTE_BITS = 8
_TOP_BYTE = WORD_BITS - _BYTE_BITS


_PAIRS = 0x5555555555555555
_QUADS = 0x3333333333333333
_BYTES = 0x0F0F0F0F0F0F0F0F
_ONES = 0x0101010101010101


def pack(members: Tensor) -> Tensor:
    """Packs membership flags into words. Returns int64 ``[*batch, ceil(rows / 64)]``.

    Args:
        members: bool ``[*batch, rows]``. Row ``r`` becomes bit ``r % 8`` of byte ``r // 8`` of the
            words' memory.

    Examples:
        >>> pack(torch.tensor([True, False, True]))
        tensor([5])
    """
    padded = torch.nn.functional.pad(members, (0, -members.shape[-1] % WORD_BITS))
    first, *rest = padded.to(torch.uint8).unflatten(-1, (-1, _BYTE_BITS)).unbind(-1)
    packed = first.contiguous()
    for bit, flags in enumerate(rest, start=1):
        packed |= flags << bit
    return packed.view(torch.int64)


def _counts_in_bytes(words: Tensor) -> Tensor:
    """Returns words in which each byte is the number of bits set in that byte of ``words``."""
    # Bits are added in pairs, in fours, then in bytes. The masks also remove the sign bits that >>
    # shifts in.
    words = words - ((words >> 1) & _PAIRS)
    words = (words & _QUADS) + ((words >> 2) & _QUADS)
    return (words + (words >> 4)) & _BYTES


def popcount(words: Tensor) -> Tensor:
    """Counts the members of each packed set. Returns long ``[*batch]``.

    Args:
        words: int64 ``[*batch, W]``.

    Examples:
        >>> popcount(torch.tensor([[5, -1]]))
        tensor([66])
    """
    return ((_counts_in_bytes(words) * _ONES) >> _TOP_BYTE).sum(-1)


def byte_counts(words: Tensor) -> Tensor:
    """Counts the members in each byte of each packed set. Returns uint8 ``[*batch, 8 * W]``.

    Args:
        words: int64 ``[*batch, W]``.

    Examples:
        >>> byte_counts(torch.tensor([0x0301]))
        tensor([1, 2, 0, 0, 0, 0, 0, 0], dtype=torch.uint8)
    """
    return _counts_in_bytes(words).view(torch.uint8)
