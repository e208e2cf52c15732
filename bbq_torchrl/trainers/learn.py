"""The learning phase of a round (freeze, epochs, freeze, epochs), and its optimizer."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.optim.adam import adam
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


class ReplicaAdam:
    """:class:`torch.optim.Adam` over parameters of replicas, with separate steps for each.

    The first dimension of the parameters is the replicas. A single Adam would also move a replica
    without a gradient, by its momentum, and share the step count. Here Adam gets a view of each
    replica's part, so a replica that is inactive in a batch stays bitwise the same, including its
    moments and step count.

    Args:
        parameters: parameters [replicas, ...]; those that do not require a gradient are left out.
        replicas: the number of replicas.
        lr: the learning rate, or one for each replica. Defaults to 1e-3, as in the paper.
        betas: as in :class:`torch.optim.Adam`.
        eps: as in :class:`torch.optim.Adam`.
        weight_decay: decoupled, as in :class:`torch.optim.AdamW`.

    Examples:
        >>> weight = nn.Parameter(torch.zeros(2, 3))
        >>> optimizer = ReplicaAdam([weight], replicas=2, lr=0.5)
        >>> weight.sum().backward()
        >>> optimizer.step(active=(True, False))
        >>> weight.detach()
        tensor([[-0.5000, -0.5000, -0.5000],
                [ 0.0000,  0.0000,  0.0000]])
    """

    def __init__(
        self,
        parameters: Iterable[nn.Parameter],
        replicas: int,
        *,
        lr: float | Sequence[float] = 1e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
        weight_decay: float = 0.0,
    ) -> None:
        self.replicas = replicas
        self.parameters = [parameter for parameter in parameters if parameter.requires_grad]
        views = [parameter.detach().unbind() for parameter in self.parameters]
        self._views = list(zip(*views, strict=True))  # of each replica
        groups = self._groups(lr)
        self._rates = [group["lr"] for group in groups]
        self._adam = torch.optim.Adam(
            groups,
            betas=betas,
            eps=eps,
            weight_decay=weight_decay,
            decoupled_weight_decay=True,
            fused=True,
        )

    def _groups(self, lr: float | Sequence[float]) -> list[dict[str, Any]]:
        """Returns Adam's parameter groups; adjacent replicas of the same rate share a group."""
        rates = [lr] * self.replicas if isinstance(lr, (int, float)) else lr
        groups: list[dict[str, Any]] = []
        for rate, views in zip(rates, self._views, strict=True):
            if not groups or groups[-1]["lr"] != rate:
                groups.append({"params": [], "lr": rate})
            groups[-1]["params"] += views
        return groups

    def zero_grad(self) -> None:
        """Sets the gradients of the parameters to None."""
        for parameter in self.parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self, active: Sequence[bool] | None = None) -> None:
        """Takes an Adam step for the active replicas.

        Args:
            active: for each replica, whether it is active. Defaults to None: all are.
        """
        flags = (True,) * self.replicas if active is None else active
        gradients = {
            views[number]: gradient
            for number, parameter in enumerate(self.parameters)
            if parameter.grad is not None
            for views, gradient, is_active in zip(self._views, parameter.grad, flags, strict=True)
            if is_active
        }
        # Adam.step is avoided: for small networks its hooks and checks cost as much as the step.
        for group in self._adam.param_groups:
            views = [view for view in group["params"] if view in gradients]
            states = [self._state(view) for view in views]
            adam(
                views,
                [gradients[view] for view in views],
                [state["exp_avg"] for state in states],
                [state["exp_avg_sq"] for state in states],
                [],
                [state["step"] for state in states],
                fused=True,
                amsgrad=False,
                beta1=group["betas"][0],
                beta2=group["betas"][1],
                lr=group["lr"],
                weight_decay=group["weight_decay"],
                decoupled_weight_decay=True,
                eps=group["eps"],
                maximize=False,
            )

    def _state(self, view: Tensor) -> dict[str, Tensor]:
        """Returns Adam's state of a view, initialized as in Adam's first step."""
        state: dict[str, Tensor] = self._adam.state[view]
        if not state:
            state["step"] = torch.zeros((), dtype=torch.float32, device=view.device)
            state["exp_avg"] = torch.zeros_like(view)
            state["exp_avg_sq"] = torch.zeros_like(view)
        return state

    def scale_lr(self, share: float) -> None:
        """Sets each replica's learning rate to this share of its initial rate."""
        for group, rate in zip(self._adam.param_groups, self._rates, strict=True):
            group["lr"] = rate * share

    def state_dict(self) -> dict[str, Any]:
        """Returns moments and step counts, as :meth:`torch.optim.Adam.state_dict` does."""
        return self._adam.state_dict()

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores a copy of the state from :meth:`state_dict`."""
        # A copy, because torch's method would share tensors with the given state.
        self._adam.load_state_dict(deepcopy(dict(state_dict)))


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
