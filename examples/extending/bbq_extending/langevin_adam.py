"""Langevin dynamics with Adam's drift, independent for each replica."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


class LangevinAdam:
    r"""Samples weights by Langevin dynamics whose drift Adam adapts (Ishfaq et al., ICLR 2024).

    A step of Adam LMCDQN, with step size η, inverse temperature β and bias factor a:

        m ← α₁ m + (1 - α₁) g,    v ← α₂ v + (1 - α₂) g²,
        w ← w - η (g + a m / √(v + λ)) + √(2η / β) ε,    ε ~ N(0, 1).

    Adam's moments are not corrected for their start, as in the paper. Parameters have the replicas
    as their first dimension; a replica that is not active stays bitwise the same. The noise comes
    from torch's global generator, at every step for all replicas, so that what one does never
    shifts another's.

    Args:
        parameters: shapes [replicas, ...]; those that do not require a gradient are left out.
        replicas: the number of replicas.

    Keyword Args:
        noisy: the parameters that get noise; None: all.
        lr: η, a number or a tensor [replicas].
        inverse_temperature: β, likewise.
        bias: a, likewise.
        betas: α₁ and α₂.
        eps: λ.

    Examples:
        >>> weight = nn.Parameter(torch.zeros(2, 3))
        >>> optimizer = LangevinAdam([weight], replicas=2, lr=0.1)
        >>> weight.sum().backward()
        >>> optimizer.step(active=(True, False))
        >>> bool(weight[0].any()), bool(weight[1].any())
        (True, False)
    """

    def __init__(
        self,
        parameters: Iterable[nn.Parameter],
        replicas: int,
        *,
        noisy: Sequence[nn.Parameter] | None = None,
        lr: float | Tensor = 1e-3,
        inverse_temperature: float | Tensor = 1e8,
        bias: float | Tensor = 1.0,
        betas: tuple[float, float] = (0.9, 0.99),
        eps: float = 1e-8,
    ) -> None:
        self.replicas = replicas
        self.parameters = [parameter for parameter in parameters if parameter.requires_grad]
        own = None if noisy is None else {id(parameter) for parameter in noisy}
        self.is_noisy = [own is None or id(parameter) in own for parameter in self.parameters]
        rate = torch.as_tensor(lr, dtype=torch.float64)
        self.rate = self.lr = rate.expand(replicas)
        self.inverse_temperature = torch.as_tensor(inverse_temperature, dtype=torch.float64)
        self.bias = torch.as_tensor(bias, dtype=torch.float64).expand(replicas)
        self.betas, self.eps = betas, eps
        self.means = [torch.zeros_like(parameter) for parameter in self.parameters]
        self.squares = [torch.zeros_like(parameter) for parameter in self.parameters]

    def zero_grad(self) -> None:
        """Clears the gradients."""
        for parameter in self.parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self, active: Sequence[bool] | None = None) -> None:
        """Moves the replicas that are active, all by default."""
        rows: Any = slice(None)
        if active is not None:
            rows = [replica for replica, is_active in enumerate(active) if is_active]
        noise_stds = (2 * self.lr / self.inverse_temperature).sqrt()
        first, second = (1 - beta for beta in self.betas)
        for parameter, mean, square, is_noisy in zip(
            self.parameters, self.means, self.squares, self.is_noisy, strict=True
        ):
            noise = torch.randn_like(parameter) if is_noisy else None
            if parameter.grad is None:
                continue
            gradient = parameter.grad[rows]
            mean[rows] = mean[rows].lerp(gradient, first)
            square[rows] = square[rows].lerp(gradient.square(), second)
            lr, noise_std, bias = (
                values.to(parameter).view(-1, *(1,) * (parameter.ndim - 1))[rows]
                for values in (self.lr, noise_stds, self.bias)
            )
            drift = gradient + bias * mean[rows] / (square[rows] + self.eps).sqrt()
            parameter[rows] -= lr * drift
            if noise is not None:
                parameter[rows] += noise_std * noise[rows]

    def scale_lr(self, share: float) -> None:
        """Scales the learning rate, and the noise with it."""
        self.lr = self.rate * share

    def state_dict(self) -> dict[str, Any]:
        """Returns Adam's moments."""
        return {"means": self.means, "squares": self.squares}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restores a copy of what :meth:`state_dict` returned."""
        for name, own in (("means", self.means), ("squares", self.squares)):
            for tensor, saved in zip(own, state_dict[name], strict=True):
                tensor.copy_(saved)
