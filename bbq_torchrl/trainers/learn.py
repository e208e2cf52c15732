"""One mini-batch after another: loss, gradient, step; sums of what the loss reports."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bbq_torchrl.modules import CudaGraph

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable

    from tensordict import TensorDictBase

    from bbq_torchrl.data import Batch
    from bbq_torchrl.trainers.optimiser import ReplicaAdam

__all__ = ["LossSums", "Update", "learn_epoch"]


_AT_ONCE = 64


class LossSums:
    """Sums over updates of every per-replica entry that a loss returns, kept on the device.

    On a CPU, where handling a few numbers costs as much as a small matrix product, the entries of
    several updates are added at once; the sums are the same bit for bit.

    Args:
        replicas (int): the number of replicas.
    """

    def __init__(self, replicas: int) -> None:
        self._replicas = replicas
        self._names: tuple[str, ...] = ()
        self._sums: Tensor | None = None
        self._pending: list[Tensor] = []
        self.updates = [0] * replicas

    def reset(self) -> None:
        """Starts again from 0, in the same memory."""
        self._pending.clear()
        if self._sums is not None:
            self._sums.zero_()
        self.updates = [0] * self._replicas

    def add(self, losses: TensorDictBase, active: Tensor | None = None) -> None:
        """Adds what a loss returned for an update; nothing here runs on the host.

        Args:
            losses (TensorDictBase): with ``loss_value`` of shape [replicas].
            active (Tensor, optional): bool [replicas]; the others' entries, which mean nothing,
                are left out. Default: all are active.
        """
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
        values = [losses.get(name) for name in self._names]
        if active is not None:
            values = [torch.where(active, value.detach(), 0.0) for value in values]
        self._pending += values
        limit = _AT_ONCE if self._sums.device.type == "cpu" else 1
        if len(self._pending) >= limit * len(self._names):
            self._add_pending()

    @torch.no_grad()
    def _add_pending(self) -> None:
        if self._sums is None or not self._pending:
            return
        values = torch.stack(self._pending).view(-1, *self._sums.shape)
        self._pending.clear()
        if len(values) == 1:
            self._sums += values[0]
        else:
            # One after the other: a sum of a block would depend, in its last bits, on which
            # updates happen to be in it.
            rows = torch.cat([self._sums.unsqueeze(0), values.double()])
            self._sums.copy_(rows.cumsum(0)[-1])

    def count(self, active: Iterable[bool]) -> None:
        """Counts an update of the active replicas."""
        self.updates = [n + is_active for n, is_active in zip(self.updates, active, strict=True)]

    def means(self) -> list[dict[str, float]]:
        """Returns the means over each replica's updates; one synchronisation with the device."""
        self._add_pending()
        assert self._sums is not None
        columns = self._sums.t().tolist()
        return [
            {name: total / updates for name, total in zip(self._names, column, strict=True)}
            for column, updates in zip(columns, self.updates, strict=True)
        ]


class Update:
    """Moves the replicas that a batch is active for: loss, gradient, step, sums.

    Nothing in it waits for the device. With ``cuda_graph``, and where the parameters are on a
    CUDA device, the update is captured (:class:`~bbq_torchrl.modules.CudaGraph`) and launched
    as one; a batch that is not active for all replicas (the ends of epochs of different lengths)
    is worked operation by operation.

    A loss whose program changes from batch to batch says so by two attributes, such as
    :class:`~bbq_torchrl.objectives.VIMELoss`'s: ``batches`` (int), which its forward counts up,
    and ``branch`` (hashable), which of its programs the next forward runs, as ``batches`` has it.
    Each gets a graph of its own.

    Args:
        loss (callable): returns ``loss``, the scalar to differentiate, and ``loss_value``
            [replicas]; whatever else it returns in shape [replicas] is averaged and reported.
        optimiser (ReplicaAdam): of its parameters.
        cuda_graph (bool): whether the update is captured. Default: ``True``.

    Attributes:
        sums (LossSums): takes in what the loss returns.
    """

    def __init__(
        self,
        loss: Callable[[TensorDictBase], TensorDictBase],
        optimiser: ReplicaAdam,
        *,
        cuda_graph: bool = True,
    ) -> None:
        self.loss = loss
        self.optimiser = optimiser
        self.sums = LossSums(optimiser.replicas)
        self._is_captured = cuda_graph and CudaGraph.works_on(optimiser.device)
        self._graphs: dict[Hashable, CudaGraph[None]] = {}

    def __call__(self, batch: Batch) -> None:
        """Updates once."""
        if not all(batch.active):
            self._work(batch.transitions, batch)
        elif self._is_captured:
            self._launch(batch.transitions)
        else:
            self._work(batch.transitions)
        self.sums.count(batch.active)

    def _work(self, transitions: TensorDictBase, batch: Batch | None = None) -> None:
        losses = self.loss(transitions)
        self.optimiser.zero_grad()
        losses["loss"].backward()
        self.optimiser.step(None if batch is None else batch.active)
        self.sums.add(losses, None if batch is None else batch.active_mask)

    def _launch(self, transitions: TensorDictBase) -> None:
        branch = (getattr(self.loss, "branch", None), transitions.batch_size)
        graph = self._graphs.get(branch)
        if graph is None:
            graph = CudaGraph(self._program(), self.optimiser.device)
            self._graphs[branch] = graph
        batches = getattr(self.loss, "batches", None)
        graph(transitions)
        if batches is not None:
            # The forward of a graph does not run on the host, and that of a capture runs twice.
            self.loss.batches = batches + 1  # type: ignore[attr-defined]

    def _program(self) -> Callable[[TensorDictBase], None]:
        """Returns the update in the branch that the loss is in now, as often as it is run."""
        batches = getattr(self.loss, "batches", None)

        def work(transitions: TensorDictBase) -> None:
            if batches is not None:
                self.loss.batches = batches  # type: ignore[attr-defined]
            self._work(transitions)

        return work


def learn_epoch(update: Update, batches: Iterable[Batch]) -> None:
    """Updates once for every batch.

    Args:
        update (Update): loss, optimiser and sums.
        batches (iterable of Batch): the epoch.
    """
    for batch in batches:
        update(batch)
