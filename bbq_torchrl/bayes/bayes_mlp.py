"""Bayes-by-Backprop networks: a linear layer and a multi-layer perceptron."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Literal, get_args

import torch
from torch import Tensor, nn

from bbq_torchrl.bayes.functional import FlatLayout, init_linear_, mlp, mlp_local
from bbq_torchrl.bayes.kl import collect_kl
from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.weight_mode import (
    WeightMode,
    check_weight_mode,
    resolve_weight_mode,
    weights_given_to,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["BayesLinear", "BayesMLP", "MeanInit"]

MeanInit = Literal["zero", "kaiming"]


class BayesMLP(nn.Module):
    """A ReLU network with a Gaussian over every weight and bias (Blundell et al. 2015).

    The paper's start is μ = 0, σ = prior_std: an agent that knows nothing acts uniformly.

    Args:
        in_features: size of the input.
        out_features: size of the output.
        hidden: sizes of the hidden layers. Defaults to (256, 256).

    Keyword Args:
        stack: leading shape of the weights; with (R,) these are R independent networks, whose
            inputs have R as their first dimension. Defaults to (), one network.
        prior_std: standard deviation of the prior, or "fan_in" for √(2/inputs) a layer. It
            decides how much is explored: under the prior Q has a variance of v₁ = p²(‖x‖² + 1),
            v_{l+1} = p²(n_l v_l / 2 + 1). A tensor [*stack] gives each network its own.
            Defaults to 0.1.
        mean_init: "zero", or "kaiming" (uniform in ±1/√inputs, what ``nn.Linear`` starts with).
        std_init: standard deviation to start with, a number or a tensor [*stack]. Defaults to
            None, the prior's.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an argument outside of what is listed.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> net = BayesMLP(268, 39, stack=(5,), prior_std="fan_in")
        >>> net(torch.ones(5, 32, 268), "draw").shape
        torch.Size([5, 32, 39])
        >>> net(torch.ones(5, 32, 268)).abs().max()  # the mean, outside of any context
        tensor(0., grad_fn=...)
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int] = (256, 256),
        *,
        stack: Sequence[int] = (),
        prior_std: float | Tensor | Literal["fan_in"] = 0.1,
        mean_init: MeanInit = "zero",
        std_init: float | Tensor | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.layout = FlatLayout((in_features, *hidden, out_features))
        if mean_init not in get_args(MeanInit):
            raise ValueError(
                f"mean_init must be one of {list(get_args(MeanInit))}, got {mean_init!r}"
            )
        if (isinstance(prior_std, str) and prior_std != "fan_in") or (
            isinstance(prior_std, (int, float)) and not prior_std > 0
        ):
            raise ValueError(f"prior_std must be positive or 'fan_in', got {prior_std!r}")
        self.mean_init = mean_init
        self.std_init = std_init
        self.posterior = GaussianPosterior(
            self.layout.layer_sizes,
            [sqrt(2 / inputs) for inputs, _ in self.layout.shapes]
            if isinstance(prior_std, str)
            else prior_std,
            stack=stack,
            device=device,
            dtype=dtype,
        )
        self.reset_parameters()

    @property
    def in_features(self) -> int:
        """Size of the input."""
        return self.layout.sizes[0]

    @property
    def out_features(self) -> int:
        """Size of the output."""
        return self.layout.sizes[-1]

    @property
    def stack(self) -> torch.Size:
        """Leading shape of the weights."""
        return self.posterior.stack

    def reset_parameters(self) -> None:
        """Starts again as ``mean_init`` and ``std_init`` say."""
        self.posterior.reset_parameters()
        if self.mean_init == "kaiming":
            init_linear_(self.posterior.mu, self.layout)
        if self.std_init is not None:
            self.posterior.reset_std_(self.std_init)

    def draw_weights(self, rows: Sequence[int] = ()) -> Tensor:
        """Returns draws of all weights, [*stack, *rows, P], to hand to :meth:`forward`."""
        return self.posterior.sample(rows)

    def forward(
        self, x: Tensor, mode: WeightMode | None = None, weights: Tensor | None = None
    ) -> Tensor:
        """Returns the outputs, shape [*stack, *batch, out].

        Args:
            x: inputs, shape [*stack, *batch, in].
            mode: "draw" (one weight draw of each element of the stack for the whole call),
                "local" (local reparameterisation: independent rows), "mean", or None for what
                :func:`~bbq_torchrl.bayes.resolve_weight_mode` says.
            weights: weights to use instead, [*stack, *rows, P] where rows are the first
                dimensions of batch: each of these rows then has weights of its own.

        Raises:
            ValueError: for another mode, or a shape that does not fit.
        """
        if weights is None:
            weights = weights_given_to(self)
        elif mode is not None:
            check_weight_mode(mode)
        if weights is not None:
            return mlp(x, weights, self.layout)
        mode = resolve_weight_mode(mode)
        posterior = self.posterior
        collector = collect_kl.active()
        if mode == "draw":
            weights = posterior.sample() if collector is None else collector.draw(posterior)
            return mlp(x, weights, self.layout)
        if collector is not None:
            collector.note(posterior)
        if mode == "mean":
            return mlp(x, posterior.mu, self.layout)
        return mlp_local(x, posterior.mu, posterior.sigma, self.layout)

    def extra_repr(self) -> str:
        """Returns the layer sizes for ``repr``."""
        return f"sizes={self.layout.sizes}"


class BayesLinear(BayesMLP):
    """A linear layer with a Gaussian over every weight and bias.

    Args:
        in_features: size of the input.
        out_features: size of the output.

    Keyword Args:
        stack: as in :class:`BayesMLP`, like the other ones.
        prior_std: standard deviation of the prior, or "fan_in" for √(2/in_features).
        mean_init: "zero" or "kaiming".
        std_init: standard deviation to start with. Defaults to None, the prior's.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an argument outside of what is listed.

    Example:
        >>> import torch
        >>> from torch import nn
        >>> from torchrl.envs.utils import ExplorationType, set_exploration_type
        >>> net = nn.Sequential(BayesLinear(3, 8), nn.Tanh(), BayesLinear(8, 2))
        >>> with set_exploration_type(ExplorationType.RANDOM):
        ...     bool((net(torch.ones(3)) == net(torch.ones(3))).any())
        False
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        *,
        stack: Sequence[int] = (),
        prior_std: float | Tensor | Literal["fan_in"] = 0.1,
        mean_init: MeanInit = "zero",
        std_init: float | Tensor | None = None,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__(
            in_features,
            out_features,
            (),
            stack=stack,
            prior_std=prior_std,
            mean_init=mean_init,
            std_init=std_init,
            device=device,
            dtype=dtype,
        )
