"""Adam for parameters of independent replicas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.adam import adam


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
