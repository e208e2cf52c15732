"""One mini-batch after another: loss, gradient, step; sums of what the loss reports."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from tensordict import TensorDictBase

    from bbq_torchrl.data import Batch
    from bbq_torchrl.trainers.optimiser import ReplicaAdam

__all__ = ["LossSums", "learn_epoch"]


class LossSums:
    """Sums over updates of every per-replica entry that a loss returns, kept on the device.

    Args:
        replicas (int): the number of replicas.
    """

    def __init__(self, replicas: int) -> None:
        self._replicas = replicas
        self._names: tuple[str, ...] = ()
        self._sums: Tensor | None = None
        self.updates = [0] * replicas

    @torch.no_grad()
    def add(self, losses: TensorDictBase, batch: Batch) -> None:
        """Adds one update; an inactive replica's entries, which mean nothing, are left out."""
        if self._sums is None:
            self._names = tuple(
                name
                for name, value in losses.items()
                if value.shape == (self._replicas,) and value.is_floating_point()
            )
            if "loss_value" not in self._names:
                raise KeyError(
                    f"the loss must return loss_value of shape [{self._replicas}], got {losses}"
                )
            self._sums = losses["loss_value"].new_zeros(
                len(self._names), self._replicas, dtype=torch.float64
            )
        values = torch.stack([losses.get(name) for name in self._names])
        if not all(batch.active):
            values = torch.where(batch.active_mask, values, 0.0)
        self._sums += values
        self.updates = [
            n + is_active for n, is_active in zip(self.updates, batch.active, strict=True)
        ]

    def means(self) -> list[dict[str, float]]:
        """Returns the means over each replica's updates; one synchronisation with the device."""
        assert self._sums is not None
        columns = self._sums.t().tolist()
        return [
            {name: total / updates for name, total in zip(self._names, column, strict=True)}
            for column, updates in zip(columns, self.updates, strict=True)
        ]


def learn_epoch(
    loss: Callable[[TensorDictBase], TensorDictBase],
    optimiser: ReplicaAdam,
    batches: Iterable[Batch],
    sums: LossSums,
) -> None:
    """Updates once for every batch.

    Args:
        loss (callable): returns ``loss``, the scalar to differentiate, and ``loss_value``
            [replicas]; whatever else it returns in shape [replicas] is averaged and reported.
        optimiser (ReplicaAdam): moves the replicas that a batch is active for.
        batches (iterable of Batch): the epoch.
        sums (LossSums): takes in what the loss returns.
    """
    for batch in batches:
        losses = loss(batch.transitions)
        optimiser.zero_grad()
        losses["loss"].backward()
        optimiser.step(batch.active)
        sums.add(losses, batch)
