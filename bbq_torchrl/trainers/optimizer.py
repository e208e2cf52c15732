"""Adam for replicas that must not touch one another."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any, Protocol

import torch
from torch import Tensor, nn
from torch.optim.adam import adam

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

__all__ = ["ReplicaAdam", "ReplicaOptimizer"]


class ReplicaOptimizer(Protocol):
    """What moves parameters whose first dimension are replicas that must not touch one another.

    :class:`ReplicaAdam` is one. What is random in one comes from torch's global generator, which
    the trainer seeds for each epoch, and is drawn for all replicas at every step.
    """

    @property
    def replicas(self) -> int:
        """The number of replicas."""

    def zero_grad(self) -> None:
        """Forgets the gradients."""

    def step(self, active: Sequence[bool] | None = None) -> None:
        """Moves the replicas that are active, all by default; the others stay bitwise the same."""

    def scale_lr(self, share: float) -> None:
        """Goes on at that share of the learning rate it was made with; called where it falls."""

    def state_dict(self) -> dict[str, Any]:
        """Returns what a resumed training needs."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores it."""


class _GroupState:
    """What Adam keeps of a group of views, in lists as its functional form takes them."""

    names = ("exp_avg", "exp_avg_sq", "step")

    def __init__(
        self,
        views: list[Tensor],
        exp_avgs: list[Tensor],
        exp_avg_sqs: list[Tensor],
        steps: list[Tensor],
    ) -> None:
        self.views = views
        self.exp_avgs = exp_avgs
        self.exp_avg_sqs = exp_avg_sqs
        self.steps = steps


class ReplicaAdam:
    """:class:`torch.optim.Adam` over parameters of replicas, each with its own steps.

    Their first dimension is the replicas'. One Adam over them would move a
    replica without a gradient too, by its momentum, and count its steps with the others'. Here
    Adam sees a view of each replica's part: a replica that a batch does not concern is left
    bitwise untouched, moments and step count included.

    Args:
        parameters (iterable of Parameter): shapes [replicas, ...]; those that do not require a
            gradient are left out.
        replicas (int): the number of replicas.
        lr (float or sequence of float): the learning rate, or one for each replica. Default: 1e-3
            (the paper's).
        betas (pair of float): as in :class:`torch.optim.Adam`.
        eps (float): as in :class:`torch.optim.Adam`.

    Example:
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
    ) -> None:
        self.replicas = replicas
        self.parameters = [parameter for parameter in parameters if parameter.requires_grad]
        if not self.parameters:
            raise ValueError("parameters must hold at least one that requires a gradient, got none")
        for parameter in self.parameters:
            if parameter.ndim == 0 or parameter.shape[0] != replicas:
                raise ValueError(
                    f"the first dimension of every parameter must be the {replicas} replicas, "
                    f"got shape {tuple(parameter.shape)}"
                )
        self._views = [
            [parameter.detach()[replica].requires_grad_() for parameter in self.parameters]
            for replica in range(replicas)
        ]
        groups = self._groups(lr)
        self._rates = [group["lr"] for group in groups]
        self._adam = torch.optim.Adam(groups, betas=betas, eps=eps, fused=True)
        self._states: list[_GroupState] = []

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.parameters[0].device

    def _groups(self, lr: float | Sequence[float]) -> list[dict[str, Any]]:
        """Returns Adam's parameter groups: neighbors of the same rate are one, as a step is."""
        rates = [lr] * self.replicas if isinstance(lr, (int, float)) else list(lr)
        if len(rates) != self.replicas:
            raise ValueError(
                f"lr must be one number or one for each of the {self.replicas} replicas, got "
                f"{len(rates)}"
            )
        groups: list[dict[str, Any]] = []
        for rate, views in zip(rates, self._views, strict=True):
            if not groups or groups[-1]["lr"] != rate:
                groups.append({"params": [], "lr": rate})
            groups[-1]["params"] += views
        return groups

    def zero_grad(self) -> None:
        """Forgets the gradients of the parameters."""
        for parameter in self.parameters:
            parameter.grad = None

    def step(self, active: Sequence[bool] | None = None) -> None:
        """Moves the replicas that are active by one Adam step.

        Args:
            active (sequence of bool, optional): for each replica, whether the last batch concerned
                it. Default: all.
        """
        if (
            (active is None or all(active))
            and all(parameter.grad is not None for parameter in self.parameters)
            and (self._states or self._has_states())
        ):
            self._step_all()
            return
        flags = (True,) * self.replicas if active is None else active
        for parameter_number, parameter in enumerate(self.parameters):
            gradients = (None,) * self.replicas if parameter.grad is None else parameter.grad
            for views, gradient, is_active in zip(self._views, gradients, flags, strict=True):
                views[parameter_number].grad = gradient if is_active else None
        self._adam.step()

    def scale_lr(self, share: float) -> None:
        """Has each replica go on at that share of the rate that it was given."""
        for group, rate in zip(self._adam.param_groups, self._rates, strict=True):
            group["lr"] = rate * share

    def _has_states(self) -> bool:
        """Whether every view has moments; notes where they are."""
        state = self._adam.state
        if not all("exp_avg" in state[view] for views in self._views for view in views):
            return False
        self._states = [
            _GroupState(
                group["params"],
                *([state[view][name] for view in group["params"]] for name in _GroupState.names),
            )
            for group in self._adam.param_groups
        ]
        return True

    @torch.no_grad()
    def _step_all(self) -> None:
        """What ``Adam.step`` does, without looking up again what it finds at each step.

        Hooks, groups and states cost as much as the step itself where the networks are small.
        """
        parts = [parameter.grad.unbind(0) for parameter in self.parameters]  # type: ignore[union-attr]
        gradients = [part[replica] for replica in range(self.replicas) for part in parts]
        options = self._adam.defaults
        first = 0
        for group, state in zip(self._adam.param_groups, self._states, strict=True):
            last = first + len(state.views)
            adam(
                state.views,
                gradients[first:last],
                state.exp_avgs,
                state.exp_avg_sqs,
                [],
                state.steps,
                fused=True,
                amsgrad=False,
                beta1=options["betas"][0],
                beta2=options["betas"][1],
                lr=group["lr"],
                weight_decay=0.0,
                eps=options["eps"],
                maximize=False,
            )
            first = last

    def state_dict(self) -> dict[str, Any]:
        """Returns moments and step counts, as :meth:`torch.optim.Adam.state_dict` does."""
        return self._adam.state_dict()

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores a copy of what :meth:`state_dict` returned."""
        self._states = []
        # torch's own would go on in the very tensors of the state that it is given.
        self._adam.load_state_dict(deepcopy(dict(state_dict)))
