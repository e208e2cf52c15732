"""Bayes-by-Backprop networks: a linear layer and a multi-layer perceptron."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.bayes.functional import FlatLayout, init_linear_, mlp, mlp_local
from bbq_torchrl.bayes.layers import BayesLayer, LayerSettings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor
    from typing_extensions import Unpack


class BayesMLP(BayesLayer):
    """A ReLU network with a Gaussian over every weight and bias (Blundell et al. 2015).

    The paper's start is μ = 0, σ = prior_std (``mean_init="zero", std_init=None``): an agent that
    knows nothing acts uniformly. From there few loops learn; the defaults start as any network
    does, with little noise.

    Args:
        in_features: size of the input.
        out_features: size of the output.
        hidden: sizes of the hidden layers. Defaults to (256, 256).

    Keyword Args:
        replicas: R independent networks side by side, whose inputs have R as their
            first dimension, or a shape of them. Defaults to (), one network.
        prior_std: standard deviation of the prior, or "fan_in" for √(2/inputs) a layer. It
            decides how much is explored: under the prior Q has a variance of v₁ = p²(‖x‖² + 1),
            v_{l+1} = p²(n_l v_l / 2 + 1). A tensor [*replicas] gives each network its own.
            Defaults to 0.037.
        mean_init: "kaiming" (uniform in ±1/√inputs, what ``nn.Linear`` starts with), or "zero", the
            paper's. Defaults to "kaiming".
        std_init: standard deviation to start with, a number or a tensor [*replicas]; None, the
            paper's, for the prior's. Defaults to 0.03.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an argument outside of what is listed.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> net = BayesMLP(268, 39, replicas=5, prior_std="fan_in")
        >>> net(torch.ones(5, 32, 268), "draw").shape
        torch.Size([5, 32, 39])
        >>> paper = BayesMLP(268, 39, mean_init="zero", std_init=None)  # the prior
        >>> paper(torch.ones(32, 268)).abs().max()  # the mean, outside of any context
        tensor(0., grad_fn=...)
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int] = (256, 256),
        **settings: Unpack[LayerSettings],
    ) -> None:
        self.in_features, self.out_features = in_features, out_features
        self.layout = FlatLayout((in_features, *hidden, out_features))
        fan_in = [inputs for inputs, _ in self.layout.shapes]
        super().__init__(self.layout.layer_sizes, fan_in, **settings)

    def init_means_(self) -> None:
        """Draws the means like ``nn.Linear``'s weights: uniform in ±1/√inputs."""
        init_linear_(self.posterior.mu, self.layout)

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Sets the weights of inactive inputs and outputs to the prior.

        See :class:`bbq_torchrl.protocols.Growing`.
        """
        posterior = self.posterior
        is_inactive = torch.zeros(self.layout.numel, dtype=torch.bool, device=posterior.mu.device)
        layers = self.layout.unflatten(is_inactive)
        layers[0][0][inputs] = True
        layers[-1][0][:, outputs] = True
        layers[-1][1][outputs] = True
        posterior.mu.masked_fill_(is_inactive, 0)
        rho = posterior.per_weight(posterior.prior_rho)
        posterior.rho.copy_(torch.where(is_inactive, rho, posterior.rho))

    def run(self, x: Tensor, weights: Tensor) -> Tensor:
        """Returns the outputs with these weights, shape [*replicas, *batch, out]."""
        return mlp(x, weights, self.layout)

    def run_local(self, x: Tensor) -> Tensor:
        """Returns the outputs by local reparameterization, shape [*replicas, *batch, out]."""
        return mlp_local(x, self.posterior.mu, self.posterior.sigma, self.layout)

    def extra_repr(self) -> str:
        """Returns the layer sizes for ``repr``."""
        return f"sizes={self.layout.sizes}"


class BayesLinear(BayesMLP):
    """A linear layer with a Gaussian over every weight and bias.

    Args:
        in_features: size of the input.
        out_features: size of the output.

    Keyword Args:
        replicas: as in :class:`BayesMLP`, like the other ones.
        prior_std: standard deviation of the prior, or "fan_in" for √(2/in_features). Defaults to
            0.037.
        mean_init: "kaiming" or "zero". Defaults to "kaiming".
        std_init: standard deviation to start with; None for the prior's. Defaults to 0.03.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an argument outside of what is listed.

    Examples:
        >>> import torch
        >>> from torch import nn
        >>> from torchrl.envs.utils import ExplorationType, set_exploration_type
        >>> net = nn.Sequential(BayesLinear(3, 8), nn.Tanh(), BayesLinear(8, 2))
        >>> with set_exploration_type(ExplorationType.RANDOM):
        ...     bool((net(torch.ones(3)) == net(torch.ones(3))).any())
        False
    """

    def __init__(
        self, in_features: int, out_features: int, **settings: Unpack[LayerSettings]
    ) -> None:
        super().__init__(in_features, out_features, (), **settings)
