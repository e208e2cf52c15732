"""The learning phase of a round: freeze, epochs of mini-batches, freeze, epochs."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.objectives.utils import TargetNetUpdater

from bbq_torchrl.data import Batch, ReplicaReplay
from bbq_torchrl.protocols import (
    BeginsEpochs,
    FitsBuffers,
    FixedTargets,
    ReplicaOptimizer,
    UsesNumData,
    provides,
)
from bbq_torchrl.trainers.checkpoint import TrainingError
from bbq_torchrl.utils.seeds import derive_seed


def losses_of(loss: nn.Module) -> list[nn.Module]:
    """Returns the losses to train together: those of a ``ModuleDict``, or the loss itself."""
    return list(loss.values()) if isinstance(loss, nn.ModuleDict) else [loss]


class LossSums:
    """Sums of every per-replica entry that a loss returns, over updates, on the device.

    Args:
        replicas: the number of replicas.

    Attributes:
        updates: the number of updates of each replica.
    """

    def __init__(self, replicas: int) -> None:
        self._replicas = replicas
        self._names: tuple[str, ...] = ()
        self._sums: Tensor | None = None
        self.updates = [0] * replicas

    def add(self, losses: TensorDictBase, batch: Batch) -> None:
        """Adds a loss's output for one update, without waiting for the device.

        Args:
            losses: the output, with ``loss_value`` [replicas]. Entries of replicas that are
                inactive in the batch are left out.
            batch: the batch of the update.

        Raises:
            TrainingError: if ``loss_value`` is missing or has another shape.
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
        values = torch.stack([losses.get(name).detach() for name in self._names])
        if not all(batch.active):
            values = torch.where(batch.transitions["valid"].any(-1), values, 0.0)
        self._sums += values

    def means(self) -> dict[str, list[float]]:
        """Returns means over each replica's updates, by name; waits for the device once."""
        assert self._sums is not None
        return {
            name: [total / updates for total, updates in zip(totals, self.updates, strict=True)]
            for name, totals in zip(self._names, self._sums.tolist(), strict=True)
        }


@dataclass(eq=False)
class Learner:
    """The learner of R replicas: freeze the target, some epochs, freeze again, some epochs.

    Args:
        loss: returns ``loss`` (scalar) and ``loss_value`` [replicas]. Further entries [replicas]
            become metrics. Several losses are passed as an ``nn.ModuleDict``: the sum of their
            ``loss`` is trained, and ``loss_value`` is the first one's.
            :mod:`bbq_torchrl.protocols` lists optional methods of losses.
        replay: the buffers.
        optimizer: the optimizer of the loss's parameters.
        target_updater: ``.step()`` freezes the target.

    Keyword Args:
        batch_size: transitions per mini-batch and replica.
        freezes: the number of target freezes in a round, each followed by learning.
        epochs: the number of epochs over the buffer after each freeze.
        lr_share: returns the share of the learning rate for a round, counted from 0. Defaults to
            None: always 1.

    Attributes:
        sums: the sums of the loss's outputs in this round.
        diverged: replicas that are not updated, since their loss was NaN or infinite.

    Raises:
        ValueError: if the optimizer does not update each replica separately.
    """

    loss: nn.Module
    replay: ReplicaReplay
    optimizer: ReplicaOptimizer
    target_updater: TargetNetUpdater
    _: KW_ONLY
    batch_size: int
    freezes: int
    epochs: int
    lr_share: Callable[[int], float] | None = None
    sums: LossSums = field(init=False)
    diverged: set[int] = field(init=False, default_factory=set)

    def __post_init__(self) -> None:
        if not provides(self.optimizer, ReplicaOptimizer):
            raise ValueError(
                "the optimizer must update each replica separately, as ReplicaAdam does, got "
                f"{type(self.optimizer).__name__}"
            )
        self._losses = losses_of(self.loss)
        self.sums = LossSums(self.optimizer.replicas)

    def learn(self, round_number: int, seed: int = 0) -> dict[str, list[float]]:
        """Learns for a round and returns the means of the losses' metrics, by name.

        Args:
            round_number: the round, from 0.
            seed: the run's seed. Defaults to 0.
        """
        self.sums = LossSums(self.replay.replicas)
        if self.lr_share is not None:
            self.optimizer.scale_lr(self.lr_share(round_number))
        for loss in self._losses:
            if provides(loss, UsesNumData):
                loss.set_num_data(self.replay.num_data())
        found: dict[str, list[float]] = {}
        if not all(provides(loss, FitsBuffers) and loss.only_fits for loss in self._losses):
            self.update_all(round_number, seed)
            found |= self.sums.means()
        for part in self._losses:
            if provides(part, FitsBuffers):
                seed_phase(seed, self.replay, "fit", round_number)
                (batch,) = self.replay.epoch(max(self.replay.lengths))
                fitted = LossSums(self.replay.replicas)
                fitted.add(part.fit(batch.transitions), batch)
                found |= fitted.means()
        return {"loss" if name == "loss_value" else name: means for name, means in found.items()}

    def update_all(self, round_number: int, seed: int = 0) -> None:
        """Freezes and learns, without waiting for the device; the arguments are those of learn."""
        for freeze in range(self.freezes):
            self.target_updater.step()
            self.compute_targets()
            for epoch in range(self.epochs):
                # Each epoch has a seed, so that its draws do not depend on the length of earlier
                # epochs, which is that of the longest replica.
                seed_phase(seed, self.replay, "learn", round_number, freeze, epoch)
                batches = self.replay.epoch(self.batch_size)
                for loss in self._losses:
                    if provides(loss, BeginsEpochs):
                        loss.begin_epoch()
                for batch in batches:
                    self.update(batch)

    def update(self, batch: Batch) -> None:
        """Updates the replicas that are active in a batch: loss, gradient, step, sums.

        It never waits for the device.
        """
        first, *others = self._losses
        out: TensorDictBase = first(batch.transitions)
        for loss in others:
            added = loss(batch.transitions)
            out.set("loss", out["loss"] + added.pop("loss"))
            out.update(added)
        self.optimizer.zero_grad()
        out["loss"].backward()
        active = [
            learns and replica not in self.diverged for replica, learns in enumerate(batch.active)
        ]
        self.optimizer.step(None if all(active) else active)
        self.sums.add(out, batch)

    def compute_targets(self) -> None:
        """Computes the frozen network's values for the whole buffer if a loss allows it."""
        for loss in self._losses:
            if provides(loss, FixedTargets) and loss.has_fixed_targets:
                key = ("next", loss.tensor_keys.next_state_value)
                self.replay.compute(key, loss.next_state_values)


def seed_phase(seed: int, replay: ReplicaReplay, *path: str | int) -> None:
    """Seeds torch and the replay's shuffling for a phase of a round.

    Args:
        seed: the run's seed.
        replay: the buffers.
        *path: the phase, such as ``("collect", 3)``.
    """
    torch.manual_seed(derive_seed(seed, "torch", *path))
    replay.seed([derive_seed(seed, "replay", r, *path) for r in range(replay.replicas)])


# From malloc.h.
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3


# Larger blocks are returned at once. Older versions of glibc accept no larger threshold.
_LARGEST_REUSED = 1 << 25


def keep_freed_memory() -> None:
    """Makes glibc keep freed memory for later allocations, in the whole process.

    An update of five replicas frees and allocates about thirty tensors of 3 MB. By default glibc
    returns such blocks to the kernel, which provides them again page by page, zeroed. That takes a
    quarter of a BBQN update on a CPU. With this setting the process stays at its peak memory.
    Without glibc nothing changes.
    """
    is_linux = sys.platform.startswith("linux")
    if is_linux and (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)):
        mallopt(_M_MMAP_THRESHOLD, _LARGEST_REUSED)
        mallopt(_M_TRIM_THRESHOLD, (1 << 31) - 1)
        mallopt(_M_TOP_PAD, 1 << 26)
