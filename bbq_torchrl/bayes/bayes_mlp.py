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

    The paper starts from the prior, μ = 0 and σ = prior_std (``mean_init="zero", std_init=None``),
    where an untrained agent acts uniformly. Training from there often fails. By default the means
    start like the weights of an ordinary network, with little noise.

    Args:
        in_features: size of the input.
        out_features: size of the output.
        hidden: sizes of the hidden layers. Defaults to (256, 256).

    Keyword Args:
        replicas: the number R of independent networks, or a shape; inputs have it as their
            leading dimensions. Defaults to (), one network.
        prior_std: standard deviation of the prior, or "fan_in" for √(2/inputs) in each layer. It
            sets the amount of exploration: under the prior the variance of Q is v₁ = p²(‖x‖² + 1),
            v_{l+1} = p²(n_l v_l / 2 + 1). A tensor [*replicas] sets it for each network.
            Defaults to "fan_in", with which Bayes' rule fits data of unit scale.
        mean_init: "kaiming" (uniform in ±1/√inputs, as in ``nn.Linear``), or "zero", as in the
            paper. Defaults to "kaiming".
        std_init: initial standard deviation, a number or a tensor [*replicas]; None, as in the
            paper, for the prior's. Defaults to 0.03.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> net = BayesMLP(268, 39, replicas=5)
        >>> net(torch.ones(5, 32, 268), "draw").shape
        torch.Size([5, 32, 39])
        >>> paper = BayesMLP(268, 39, mean_init="zero", std_init=None)  # starts at the prior
        >>> paper(torch.ones(32, 268)).abs().max()  # the mean network, outside of any context
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
        """Draws the means like the weights of ``nn.Linear``: uniform in ±1/√inputs."""
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
        replicas: as in :class:`BayesMLP`.
        prior_std: standard deviation of the prior, or "fan_in" for √(2/in_features). Defaults to
            "fan_in".
        mean_init: "kaiming" or "zero". Defaults to "kaiming".
        std_init: initial standard deviation; None for the prior's. Defaults to 0.03.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an invalid argument.

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
