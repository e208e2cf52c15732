"""Multi-layer perceptrons with a replica dimension: a plain one, and a noisy one (NoisyNet)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import NoisyLinear

from bbq_torchrl.bayes.functional import FlatLayout, as_rows, init_linear_, mlp, replica_shape
from bbq_torchrl.bayes.scope import WEIGHT_MODE, WeightMode, current_scope, resolve_weight_mode
from bbq_torchrl.settings import ABOVE_ZERO, BELOW_ONE, check


class FlatMLP(nn.Module):
    """A ReLU network, or independent replicas of it, with dropout after each hidden layer.

    Args:
        in_features: size of the input.
        out_features: size of the output.
        hidden: sizes of the hidden layers. Defaults to (256, 256).

    Keyword Args:
        replicas: the number R of independent networks, or a shape; inputs have it as their
            leading dimensions. Defaults to (), one network.
        dropout: probability of dropping a hidden unit. Defaults to 0.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: if dropout is not in [0, 1).

    Examples:
        >>> import torch
        >>> net = FlatMLP(3, 2, (16,), replicas=5, dropout=0.5)
        >>> x = torch.ones(5, 7, 3)
        >>> net(x).shape, torch.equal(net(x, "mean"), net(x, "mean"))
        (torch.Size([5, 7, 2]), True)
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int] = (256, 256),
        *,
        replicas: int | Sequence[int] = (),
        dropout: float = 0.0,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        check("dropout", dropout, BELOW_ONE)
        self.in_features, self.out_features = in_features, out_features
        self.layout = FlatLayout((in_features, *hidden, out_features))
        self.replicas = replica_shape(replicas)
        self.dropout = dropout
        self.weight = nn.Parameter(
            torch.empty((*self.replicas, self.layout.numel), device=device, dtype=dtype)
        )
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draws the weights like ``nn.Linear``: uniform in ±1/√inputs."""
        init_linear_(self.weight, self.layout)

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Sets the weights of inactive inputs to 0.

        See :class:`bbq_torchrl.protocols.Growing`.
        """
        self.layout.unflatten(self.weight)[0][0][..., inputs, :] = 0

    def forward(self, x: Tensor, mode: WeightMode | None = None) -> Tensor:
        """Returns the outputs, shape [*replicas, *batch, out].

        Args:
            x: inputs, shape [*replicas, *batch, in].
            mode: "draw" or "local" (dropout on), "mean" (off), or None: the mode of the
                :func:`~bbq_torchrl.bayes.weight_scope`; outside of any, dropout is on in training
                mode, as for ``nn.Dropout``.

        Raises:
            ValueError: for an unknown mode or a wrong shape.
        """
        if mode is not None:
            check("mode", mode, WEIGHT_MODE)
        else:
            mode = current_scope().mode or ("draw" if self.training else "mean")
        return mlp(x, self.weight, self.layout, 0.0 if mode == "mean" else self.dropout)

    def extra_repr(self) -> str:
        """Returns the sizes for ``repr``."""
        return f"sizes={self.layout.sizes}, replicas={tuple(self.replicas)}, dropout={self.dropout}"


class ReplicaNoisyLinear(NoisyLinear):
    """TorchRL's NoisyLinear with a replica dimension and new noise in each call.

    Parameters, their names and initial values are those of :class:`~torchrl.modules.NoisyLinear`,
    with leading replica dimensions: weights μ + σ ∘ (ε_out ⊗ ε_in) and biases μ + σ ∘ ε_out with
    the factorized noise ε = sgn(z) √|z|, z ~ N(0, 1) (Fortunato et al., Noisy Networks for
    Exploration, 2018).
    TorchRL's layer stores ε in buffers until ``reset_noise``. Here each call draws new noise from
    torch's global generator. So states, copies and frozen targets contain no noise, other calls may
    come between a forward and its backward pass, and ``reset_noise`` has nothing to do.

    Args:
        in_features: size of the input.
        out_features: size of the output.

    Keyword Args:
        replicas: leading shape of the parameters. Defaults to (), one layer.
        std_init: initially σ is std_init/√in_features for weights and std_init/√out_features for
            biases (as in TorchRL; the paper divides both by √in_features). Defaults to 0.5.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: if std_init is not positive.

    Examples:
        >>> import torch
        >>> from torch import nn
        >>> from torchrl.envs.utils import ExplorationType, set_exploration_type
        >>> from bbq_torchrl.networks import ReplicaNoisyLinear
        >>> net = nn.Sequential(ReplicaNoisyLinear(3, 8), nn.Tanh(), ReplicaNoisyLinear(8, 2))
        >>> with set_exploration_type(ExplorationType.RANDOM):
        ...     torch.equal(net(torch.ones(3)), net(torch.ones(3)))
        False
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        *,
        replicas: int | Sequence[int] = (),
        std_init: float = 0.5,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        check("std_init", std_init, ABOVE_ZERO)
        super().__init__(in_features, out_features, device=device, dtype=dtype, std_init=std_init)
        self.replicas = replica_shape(replicas)
        del self.weight_epsilon, self.bias_epsilon
        for name, parameter in list(self.named_parameters()):
            empty = parameter.new_empty((*self.replicas, *parameter.shape))
            setattr(self, name, nn.Parameter(empty))
        self.reset_parameters()

    def reset_noise(self) -> None:
        """Does nothing: each call draws new noise."""

    def _should_use_noise(self) -> bool:
        return False  # weight and bias are the means; each call draws the noise

    def _noise(self, *shape: int) -> Tensor:
        """Returns sgn(z) √|z| with z ~ N(0, 1)."""
        return self._scale_noise(shape).to(self.weight_mu.dtype)

    def forward(self, x: Tensor, mode: WeightMode | None = None) -> Tensor:
        """Returns the outputs, shape [*replicas, *batch, out].

        Args:
            x: inputs, shape [*replicas, *batch, in].
            mode: "draw" (one noise draw of each replica for the whole call), "local"
                (separate noise for each row), "mean" (μ), or None, which
                :func:`~bbq_torchrl.bayes.scope.resolve_weight_mode` resolves.

        Raises:
            ValueError: for an unknown mode or a wrong shape.
        """
        mode = resolve_weight_mode(mode)
        # W xᵀ, features first, so that the gradient of W has the memory layout of W.
        columns = as_rows(x, self.replicas, self.in_features).mT
        count, _, batch = columns.shape
        weight, weight_sigma, bias, bias_sigma = (
            parameter.reshape(count, self.out_features, -1)
            for parameter in (self.weight_mu, self.weight_sigma, self.bias_mu, self.bias_sigma)
        )
        if mode == "draw":
            noise_in = self._noise(count, 1, self.in_features)
            noise_out = self._noise(count, self.out_features, 1)
            weight = torch.addcmul(weight, weight_sigma, noise_out * noise_in)
            bias = torch.addcmul(bias, bias_sigma, noise_out)
        out = torch.baddbmm(bias, weight, columns)
        if mode == "local":
            # Σ_j σ_ij ε_i ε_j x_j + σ_i ε_i = ε_i (Σ_j σ_ij (ε_j x_j) + σ_i), with ε of each row
            noise_in = self._noise(count, self.in_features, batch)
            noise_out = self._noise(count, self.out_features, batch)
            spread = torch.baddbmm(bias_sigma, weight_sigma, columns * noise_in)
            out = torch.addcmul(out, spread, noise_out)
        return out.mT.reshape(*x.shape[:-1], self.out_features)


class NoisyMLP(nn.Module):
    """A ReLU network whose layers are all noisy (NoisyNet), or independent replicas of it.

    The loss alone trains σ along with μ, without the prior and KL of
    :class:`~bbq_torchrl.bayes.BayesMLP`.

    Args:
        in_features: size of the input.
        out_features: size of the output.
        hidden: sizes of the hidden layers. Defaults to (256, 256).

    Keyword Args:
        replicas: the number R of independent networks, or a shape; inputs have it as their
            leading dimensions. Defaults to (), one network.
        std_init: scale σ₀ of the initial standard deviations, see :class:`ReplicaNoisyLinear`.
            Defaults to 0.5, as in the paper and TorchRL.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: if std_init is not positive.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.networks import NoisyMLP
        >>> net, x = NoisyMLP(3, 2, (16,), replicas=5), torch.ones(5, 7, 3)
        >>> net(x, "draw").shape
        torch.Size([5, 7, 2])
        >>> torch.equal(net(x, "draw"), net(x, "draw")), torch.equal(net(x), net(x, "mean"))
        (False, True)
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int] = (256, 256),
        *,
        replicas: int | Sequence[int] = (),
        std_init: float = 0.5,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.in_features, self.out_features = in_features, out_features
        self.replicas = replica_shape(replicas)
        self.layers = nn.ModuleList(
            ReplicaNoisyLinear(
                inputs, outputs, replicas=replicas, std_init=std_init, device=device, dtype=dtype
            )
            for inputs, outputs in FlatLayout((in_features, *hidden, out_features)).shapes
        )

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Sets μ and σ of the weights of inactive inputs to 0.

        See :class:`bbq_torchrl.protocols.Growing`.
        """
        first = noisy_layers(self)[0]
        first.weight_mu[..., inputs] = 0
        first.weight_sigma[..., inputs] = 0

    def reset_parameters(self) -> None:
        """Initializes the layers again: μ uniform in ±1/√inputs, σ by ``std_init``."""
        for layer in noisy_layers(self):
            layer.reset_parameters()

    def forward(self, x: Tensor, mode: WeightMode | None = None) -> Tensor:
        """Returns the outputs, shape [*replicas, *batch, out].

        Args:
            x: inputs, shape [*replicas, *batch, in].
            mode: "draw" (one noise draw of each replica for the whole call), "local" (a separate
                draw for each row; exact, as factorized noise needs no weights for each row),
                "mean" (μ), or None, which
                :func:`~bbq_torchrl.bayes.scope.resolve_weight_mode` resolves.

        Raises:
            ValueError: for an unknown mode or a wrong shape.
        """
        mode = resolve_weight_mode(mode)
        for k, layer in enumerate(self.layers):
            x = layer(x if k == 0 else x.relu(), mode)
        return x


def noisy_layers(module: nn.Module) -> list[ReplicaNoisyLinear]:
    """Returns the noisy layers in ``module``.

    Raises:
        ValueError: if the module has no noisy layer.
    """
    layers = [m for m in module.modules() if isinstance(m, ReplicaNoisyLinear)]
    if not layers:
        raise ValueError(
            "NoisyNet needs a network with noisy layers (NoisyMLP, ReplicaNoisyLinear), got "
            f"{type(module).__name__} without any"
        )
    return layers
