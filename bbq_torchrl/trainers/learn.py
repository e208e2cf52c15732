"""The learning of a round: freeze, epochs of mini-batches, freeze, epochs."""

from __future__ import annotations

import ctypes
import sys
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from bbq_torchrl.protocols import BeginsEpochs, FixedTargets, UsesNumData, provides
from bbq_torchrl.trainers.errors import TrainingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tensordict import TensorDictBase
    from torchrl.objectives.utils import TargetNetUpdater

    from bbq_torchrl.data import Batch, ReplicaReplay
    from bbq_torchrl.protocols import ReplicaOptimizer


_AT_ONCE = 64


def losses_of(loss: nn.Module) -> list[nn.Module]:
    """Returns the losses that are trained together: those of a ``ModuleDict``, or the one given."""
    return list(loss.values()) if isinstance(loss, nn.ModuleDict) else [loss]


class LossSums:
    """Sums over updates of every per-replica entry that a loss returns, kept on the device.

    Handling a few numbers costs as much as a small matrix product, so the entries of several
    updates are added at once; on a CPU the sums are the same bit for bit.

    Args:
        replicas: the number of replicas.
    """

    def __init__(self, replicas: int) -> None:
        self._replicas = replicas
        self._names: tuple[str, ...] = ()
        self._sums: Tensor | None = None
        self._pending: list[Tensor] = []
        self.updates = [0] * replicas

    def add(self, losses: TensorDictBase, batch: Batch) -> None:
        """Adds what a loss returned for an update of a batch; nothing here runs on the host.

        Args:
            losses: with ``loss_value`` of shape [replicas]; the entries of replicas that the batch
                is not active for mean nothing, and are left out.
            batch: what it was computed from.

        Raises:
            TrainingError: if there is no such ``loss_value``.
        """
        counted = zip(self.updates, batch.active, strict=True)
        self.updates = [count + learned for count, learned in counted]
        if self._sums is None:
            self._names = tuple(
                name
                for name, value in losses.items()
                if value.shape == (self._replicas,) and value.is_floating_point()
            )
            if "loss_value" not in self._names:
                found = losses.get("loss_value", None)
                got = "none" if found is None else f"shape {list(found.shape)}"
                raise TrainingError(
                    f"the loss must return loss_value of shape [{self._replicas}], got {got}: does "
                    "the network have .replicas, and is the loss one of bbq_torchrl.objectives?"
                )
            self._sums = losses["loss_value"].new_zeros(
                len(self._names), self._replicas, dtype=torch.float64
            )
        values = [losses.get(name) for name in self._names]
        if not all(batch.active):
            is_active = batch.transitions["valid"].any(-1)
            values = [torch.where(is_active, value.detach(), 0.0) for value in values]
        self._pending += values
        if len(self._pending) >= _AT_ONCE * len(self._names):
            self._add_pending()

    @torch.no_grad()
    def _add_pending(self) -> None:
        if self._sums is None or not self._pending:
            return
        values = torch.stack(self._pending).view(-1, *self._sums.shape)
        self._pending.clear()
        # One after the other: a sum of a block would depend, in its last bits, on which updates
        # happen to be in it.
        rows = torch.cat([self._sums.unsqueeze(0), values.double()])
        self._sums.copy_(rows.cumsum(0)[-1])

    def means(self) -> dict[str, list[float]]:
        """Returns by name the means over each replica's updates; waits once for the device."""
        self._add_pending()
        assert self._sums is not None
        return {
            name: [total / updates for total, updates in zip(totals, self.updates, strict=True)]
            for name, totals in zip(self._names, self._sums.tolist(), strict=True)
        }


@dataclass(eq=False)
class Update:
    """Moves the replicas that a batch is active for: loss, gradient, step, sums.

    Nothing in it waits for the device.

    Args:
        loss: one, or several in a ``ModuleDict``. Each returns ``loss``, a scalar, whose sum is
            differentiated; the first also ``loss_value`` [replicas]. Other entries of shape
            [replicas] are averaged and reported.
        optimizer: of its parameters.

    Attributes:
        sums: takes in what the loss returns.
    """

    loss: nn.Module
    optimizer: ReplicaOptimizer
    sums: LossSums = field(init=False)

    def __post_init__(self) -> None:
        self._losses = losses_of(self.loss)
        self.sums = LossSums(self.optimizer.replicas)

    def __call__(self, batch: Batch) -> None:
        """Updates once."""
        first, *others = self._losses
        out: TensorDictBase = first(batch.transitions)
        for loss in others:
            added = loss(batch.transitions)
            out.set("loss", out["loss"] + added.pop("loss"))
            out.update(added)
        self.optimizer.zero_grad()
        out["loss"].backward()
        self.optimizer.step(None if all(batch.active) else batch.active)
        self.sums.add(out, batch)


@dataclass(eq=False)
class Learner:
    """Learns from the buffers of R replicas: freeze, some epochs, freeze again, some epochs.

    Args:
        loss: one, or several in a ``ModuleDict``, see :class:`~bbq_torchrl.trainers.RoundTrainer`;
            their optional methods are in :mod:`bbq_torchrl.protocols`.
        replay: the buffers.
        optimizer: of the loss's parameters.
        target_updater: ``.step()`` freezes the target.
        seed_phase: seeds all that is random for a phase, which it is given as a name and numbers;
            called before each epoch.

    Keyword Args:
        batch_size: transitions of a mini-batch, for each replica.
        freezes: how often in a round the target is frozen and learned against.
        epochs: how many epochs over the buffer follow each freeze.
        updates_per_round: the number of updates in every round, spread over the freezes, in place
            of the epochs. Early buffers are small, so epochs make few updates of them. Defaults
            to None: as many as the epochs have.
        lr_share: returns the share of the learning rate that a round, counted from 0, learns with.
            Defaults to None: all of it, always.
    """

    loss: nn.Module
    replay: ReplicaReplay
    optimizer: ReplicaOptimizer
    target_updater: TargetNetUpdater
    seed_phase: Callable[..., None]
    _: KW_ONLY
    batch_size: int
    freezes: int
    epochs: int
    updates_per_round: int | None = None
    lr_share: Callable[[int], float] | None = None

    def __post_init__(self) -> None:
        self._losses = losses_of(self.loss)
        self._update = Update(self.loss, self.optimizer)

    @property
    def updates(self) -> list[int]:
        """The number of updates of each replica in the round."""
        return self._update.sums.updates

    def learn(self, round_number: int) -> dict[str, list[float]]:
        """Learns for a round. Returns the means of the losses' metrics, for each replica."""
        self._update.sums = LossSums(self.replay.replicas)
        if self.lr_share is not None:
            self.optimizer.scale_lr(self.lr_share(round_number))
        for loss in self._losses:
            if provides(loss, UsesNumData):
                loss.set_num_data(self.replay.num_data())
        self.update_all(round_number)
        return {
            "loss" if name == "loss_value" else name: means
            for name, means in self._update.sums.means().items()
        }

    def update_all(self, round_number: int) -> None:
        """Freezes and learns, without waiting for the device."""
        for freeze in range(self.freezes):
            self.target_updater.step()
            self.compute_targets()
            for batches in self._batches(round_number, freeze):
                for loss in self._losses:
                    if provides(loss, BeginsEpochs):
                        loss.begin_epoch()
                for batch in batches:
                    self._update(batch)

    def _batches(self, round_number: int, freeze: int) -> Iterator[list[Batch]]:
        """Yields what is learned after one freeze, some batches at a time."""
        if self.updates_per_round is None:
            for epoch in range(self.epochs):
                # A seed for every epoch: its length is that of the longest replica's, and the
                # draws of the next epoch must not depend on it.
                self.seed_phase("learn", round_number, freeze, epoch)
                yield self.replay.epoch(self.batch_size)
        else:
            share, rest = divmod(self.updates_per_round, self.freezes)
            self.seed_phase("learn", round_number, freeze, 0)
            yield from self.replay.batches(self.batch_size, share + (freeze < rest))

    def compute_targets(self) -> None:
        """Computes the frozen network's values for the whole buffer, where a loss allows it."""
        for loss in self._losses:
            if provides(loss, FixedTargets) and loss.has_fixed_targets:
                key = ("next", loss.tensor_keys.next_state_value)
                self.replay.compute(key, loss.next_state_values)


# From malloc.h.
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3


# Blocks from this size on are given back at once. Older versions of glibc accept no more.
_LARGEST_KEPT = 1 << 25


def keep_freed_memory() -> bool:
    """Makes the C library keep freed memory for the next allocation, in the whole process.

    An update of five replicas frees and allocates some thirty tensors of 3 MB. glibc's defaults
    return such blocks to the kernel, which hands them back page by page, zeroed: a quarter of the
    time of a BBQN update on a CPU. The process keeps its peak of memory instead.

    Returns:
        whether there is a glibc that was told; elsewhere nothing is changed.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    settings = {
        _M_MMAP_THRESHOLD: _LARGEST_KEPT,
        _M_TRIM_THRESHOLD: (1 << 31) - 1,
        _M_TOP_PAD: 1 << 26,
    }
    return all(mallopt(name, value) == 1 for name, value in settings.items())
