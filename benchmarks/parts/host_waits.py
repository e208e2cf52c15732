"""Detection, on a CPU, of operations that would wait for a CUDA device."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING
from unittest.mock import patch

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from bbq_torchrl.objectives import BBQNLoss

if TYPE_CHECKING:
    from collections.abc import Iterator

# Operations whose result's shape or value the host needs.
WAITING = {
    "aten::_local_scalar_dense",
    "aten::item",
    "aten::is_nonzero",
    "aten::equal",
    "aten::nonzero",
    "aten::nonzero_numpy",
    "aten::masked_select",
    "aten::_unique",
    "aten::_unique2",
    "aten::unique_dim",
    "aten::unique_consecutive",
    "aten::bincount",
    "aten::repeat_interleave",
}
# Python's numbers as a tensor: on a CUDA device a copy that the host waits for.
FROM_THE_HOST = {"aten::lift_fresh", "aten::lift_fresh_copy"}
BY_INDEX = {"aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_"}


class HostWaitError(AssertionError):
    """An operation that would make the host wait for a CUDA device."""


class NeverWaits(TorchDispatchMode):
    """Refuses, on any device, operations that would make the host wait for a CUDA device."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name = func._schema.name
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
        if name in WAITING or name in FROM_THE_HOST:
            raise HostWaitError(f"{func} makes the host wait")
        if name in BY_INDEX and any(
            index is not None and index.dtype in (torch.bool, torch.uint8) for index in args[1]
        ):
            raise HostWaitError(f"{func} with a mask makes the host wait")
        out = func(*args, **(kwargs or {}))
        devices = {t.device for t in [*tensors, *tree_leaves(out)] if _has_place(t)}
        if len(devices) > 1:
            raise HostWaitError(f"{func} has tensors on {devices}")
        return out


def _has_place(tensor: object) -> bool:
    """Returns whether a tensor's device matters: single numbers on a CPU are passed by value."""
    return isinstance(tensor, torch.Tensor) and not (
        tensor.device.type == "cpu" and tensor.ndim == 0
    )


@contextmanager
def drawn_as_on_a_device() -> Iterator[None]:
    """Draws noise by torch's generator and caches nothing, as on a CUDA device."""
    with (
        patch("bbq_torchrl.bayes.posterior.fill_normal_", lambda out: out.normal_()),
        patch.object(BBQNLoss, "_cache_for", lambda loss, tensors: None),
    ):
        yield
