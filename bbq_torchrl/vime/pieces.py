"""Rows worked on some at a time, so that none depends on how many others there are."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import torch.nn.functional as F

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from torch import Tensor

__all__ = ["pieces"]

_PIECE = 256


def pieces(replicas: Sequence[int], *entries: Tensor) -> Iterator[list[Tensor]]:
    """Yields entries [*replicas, rows, *] some rows at a time.

    With more than one replica the last piece is filled up: what a matrix product rounds to depends
    on its shape, and a row's must not depend on how many rows another replica has.
    """
    if prod(replicas) > 1:
        missing = -entries[0].shape[-2] % _PIECE
        entries = tuple(F.pad(entry, (0, 0, 0, missing)) for entry in entries)
    yield from (list(piece) for piece in zip(*(e.split(_PIECE, -2) for e in entries), strict=True))
