"""Rows of replicas of different lengths as one TensorDict, and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase

__all__ = ["pad_rows", "unpad_rows"]


def pad_rows(rows: Sequence[TensorDictBase]) -> TensorDictBase:
    """Returns rows of R replicas as one TensorDict [R, rows], the shorter ones padded.

    Its entry ``valid`` (bool [R, rows]) tells the rows that count from the padding, which is 0.

    Args:
        rows: for each replica, batch size [its rows], with the same entries.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> rows = [TensorDict({"x": torch.ones(n)}, [n]) for n in (2, 1)]
        >>> pad_rows(rows)["x"], pad_rows(rows)["valid"]
        (tensor([[1., 1.],
                [1., 0.]]), tensor([[ True,  True],
                [ True, False]]))
    """
    lengths = [len(td) for td in rows]
    longest = max(lengths)
    padded = [
        TensorDict.cat([td, _blank(td, longest - len(td))]) if len(td) < longest else td
        for td in rows
    ]
    stacked: TensorDictBase = TensorDict.stack(padded)
    place = torch.arange(longest, device=stacked.device)
    sizes = torch.tensor(lengths, device=stacked.device)
    return stacked.set("valid", place < sizes.unsqueeze(-1))


def _blank(like: TensorDictBase, count: int) -> TensorDictBase:
    blank: TensorDictBase = like.apply(
        lambda entry: entry.new_zeros((count, *entry.shape[1:])), batch_size=[count]
    )
    return blank


def unpad_rows(stacked: TensorDictBase, lengths: Sequence[int]) -> list[TensorDictBase]:
    """Returns each replica's rows, batch sizes [its rows], of what :func:`pad_rows` made.

    Args:
        stacked: batch size [R, rows].
        lengths: the number of rows of each replica.
    """
    return [stacked[replica, :length] for replica, length in enumerate(lengths)]
