"""The base class of Bayesian layers, and the layers: linear and convolutional."""

from __future__ import annotations

from math import prod, sqrt
from operator import index
from typing import TYPE_CHECKING, Literal, SupportsIndex, TypedDict, get_args

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bbq_torchrl.bayes.functional import as_rows
from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.scope import WeightMode, current_scope, resolve_weight_mode, weight_scope
from bbq_torchrl.settings import check, one_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager

    from typing_extensions import Unpack

    from bbq_torchrl.bayes.scope import WeightScope


MeanInit = Literal["zero", "kaiming"]


class LayerSettings(TypedDict, total=False):
    """Keyword arguments of every layer; see :class:`BayesLayer` for meanings and defaults."""

    replicas: int | Sequence[int]
    prior_std: float | Tensor | Literal["fan_in"]
    mean_init: MeanInit
    std_init: float | Tensor | None
    device: torch.device | str | None
    dtype: torch.dtype | None


class BayesLayer(nn.Module):
    """The base class of layers whose weights have a Gaussian posterior.

    A subclass calls this constructor and implements :meth:`run`. If it can draw independently for
    each row without a batch of weights, it also implements :meth:`run_local`, which Thompson
    sampling at every step then uses. It inherits modes, given weights, noise and KL. (A module that
    contains a :class:`GaussianPosterior` and calls its ``weights()`` follows a
    :func:`weight_scope` as well.)

    Args:
        group_sizes: the number of weights in each group; P is their sum.
        fan_in: the number of inputs of a unit in each group, the scale of "fan_in" and "kaiming".

    Keyword Args:
        replicas: the number R of independent layers, or a shape; inputs have it as their
            leading dimensions. Defaults to (), one layer.
        prior_std: standard deviation of the prior, a number, a tensor [*replicas], or "fan_in" for
            √(2/fan_in) in each group. Defaults to "fan_in".
        mean_init: "kaiming" (uniform in ±1/√fan_in, as in torch's layers), or "zero", as in the
            paper. Defaults to "kaiming".
        std_init: initial standard deviation, a number or a tensor [*replicas]; None, as in the
            paper, for the prior's. Defaults to 0.03.
        device: of the parameters.
        dtype: of the parameters.

    Attributes:
        posterior: the :class:`GaussianPosterior` of the weights.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesLayer, kl_divergence, weight_scope
        >>> class BayesScale(BayesLayer):
        ...     def __init__(self, features, **settings):
        ...         super().__init__([features], [1], **settings)
        ...
        ...     def run(self, x, weights):
        ...         return x * weights
        >>> layer = BayesScale(3, prior_std=0.5)
        >>> with weight_scope("draw", kl="closed") as scope:
        ...     y = layer(torch.ones(4, 3))
        >>> torch.allclose(scope.kl.total(), kl_divergence(layer))
        True
    """

    def __init__(
        self,
        group_sizes: Sequence[int],
        fan_in: Sequence[int],
        *,
        replicas: int | Sequence[int] = (),
        prior_std: float | Tensor | Literal["fan_in"] = "fan_in",
        mean_init: MeanInit = "kaiming",
        std_init: float | Tensor | None = 0.03,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        check("mean_init", mean_init, one_of(*get_args(MeanInit)))
        if isinstance(prior_std, str):
            check("prior_std", prior_std, one_of("fan_in"))
        self.fan_in = tuple(fan_in)
        self.mean_init = mean_init
        self.std_init = std_init
        self.posterior = GaussianPosterior(
            group_sizes,
            [sqrt(2 / inputs) for inputs in fan_in] if isinstance(prior_std, str) else prior_std,
            replicas=replicas,
            device=device,
            dtype=dtype,
        )
        self.reset_parameters()

    @property
    def replicas(self) -> torch.Size:
        """Leading shape of the weights."""
        return self.posterior.replicas

    def reset_parameters(self) -> None:
        """Initializes the parameters as ``mean_init`` and ``std_init`` say."""
        self.posterior.reset_parameters()
        if self.mean_init == "kaiming":
            self.init_means_()
        if self.std_init is not None:
            self.posterior.reset_std_(self.std_init)

    @torch.no_grad()
    def init_means_(self) -> None:
        """Draws the means uniformly in ±1/√fan_in."""
        parts = self.posterior.mu.split(self.posterior.group_sizes, -1)
        for part, inputs in zip(parts, self.fan_in, strict=True):
            part.uniform_(-1 / sqrt(inputs), 1 / sqrt(inputs))

    def draw_weights(self, rows: Sequence[int] = ()) -> Tensor:
        """Returns draws of all weights, [*replicas, *rows, P], for :meth:`forward`."""
        scope = current_scope()
        return self.posterior.sample(rows, noise=scope.noise, sigma=scope.sigma)

    def run(self, x: Tensor, weights: Tensor) -> Tensor:
        """Returns the outputs with these weights.

        Args:
            x: inputs, [*replicas, *batch, *features].
            weights: [*replicas, *rows, P], where rows are the first dimensions of batch: separate
                weights for each of these rows.
        """
        raise NotImplementedError

    def run_local(self, x: Tensor) -> Tensor:
        """Returns the outputs with separate weights for each row, without drawing them all.

        Raises:
            ValueError: unless a subclass implements it.
        """
        raise ValueError(
            f'{type(self).__name__} has no local reparameterization: use mode "draw", or pass '
            "separate weights for each row from draw_weights(rows)"
        )

    def forward(
        self, x: Tensor, mode: WeightMode | None = None, weights: Tensor | None = None
    ) -> Tensor:
        """Returns the outputs, shape [*replicas, *batch, *features].

        Args:
            x: inputs, shape [*replicas, *batch, *features].
            mode: "draw" (one weight draw of each replica for the whole call),
                "local" (a separate draw for each row), "mean", or None, which
                :func:`~bbq_torchrl.bayes.scope.resolve_weight_mode` resolves.
            weights: weights to use instead, [*replicas, *rows, P], where rows are the first
                dimensions of batch: separate weights for each of these rows.

        Raises:
            ValueError: for an unknown mode or a wrong shape.
        """
        mode, scope = resolve_weight_mode(mode), current_scope()
        if weights is None and mode == "local":
            weights = scope.weights.get(self.posterior)
            if weights is None:
                if scope.kl is not None:
                    self.posterior.add_kl(scope.kl)
                return self.run_local(x)
        return self.run(x, self.posterior.weights(mode) if weights is None else weights)


def local_weight_scope(module: nn.Module, batch: torch.Size) -> AbstractContextManager[WeightScope]:
    """Returns a weight scope with separate weights for each row of a batch.

    Layers use local reparameterization; posteriors whose layer lacks it are drawn for each row.

    Args:
        module: the module to be called within the scope.
        batch: the batch shape, [*replicas, *rows].
    """
    parts = list(module.modules())
    local = {
        part.posterior
        for part in parts
        if isinstance(part, BayesLayer) and type(part).run_local is not BayesLayer.run_local
    }
    found = [part for part in parts if isinstance(part, GaussianPosterior) and part not in local]
    drawn = {posterior: posterior.sample(batch[len(posterior.replicas) :]) for posterior in found}
    return weight_scope("local", weights=drawn or None)


class BayesConv2d(BayesLayer):
    """A 2d convolution with a Gaussian over every weight and bias.

    In mode "local" each row has a separate draw of the whole kernel. Separate noise for each output
    position, as in Kingma, Salimans and Welling's dense layers, would not correspond to a draw of
    the kernel: the positions would be independent.

    Args:
        in_channels: channels of the input.
        out_channels: channels of the output.
        kernel_size: height and width of the kernel; one number sets both.

    Keyword Args:
        stride: as in ``nn.Conv2d``. Defaults to 1.
        padding: as in ``nn.Conv2d``, a number or a pair. Defaults to 0.
        replicas: the number R of independent convolutions, or a shape; inputs have it as their
            leading dimensions. Defaults to ().
        prior_std: standard deviation of the prior, a number, a tensor [*replicas], or "fan_in" for
            √(2/(in_channels · kernel)). Defaults to "fan_in".
        mean_init: "kaiming" (uniform in ±1/√fan_in, as in ``nn.Conv2d``), or "zero".
            Defaults to "kaiming".
        std_init: initial standard deviation; None for the prior's. Defaults to 0.03.
        device: of the parameters.
        dtype: of the parameters.

    Raises:
        ValueError: for an invalid argument or, when called, an input of the wrong shape.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesConv2d
        >>> net = BayesConv2d(3, 8, 3, replicas=5, padding=1)
        >>> net(torch.ones(5, 32, 3, 10, 10), "draw").shape
        torch.Size([5, 32, 8, 10, 10])
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: int | tuple[int, int],
        *,
        stride: int | tuple[int, int] = 1,
        padding: int | tuple[int, int] = 0,
        **settings: Unpack[LayerSettings],
    ) -> None:
        if isinstance(kernel_size, SupportsIndex):
            kernel_size = (index(kernel_size), index(kernel_size))
        self.in_channels, self.out_channels = in_channels, out_channels
        self.kernel_size = kernel_size
        self.stride, self.padding = stride, padding
        inputs = in_channels * prod(kernel_size)
        super().__init__([(inputs + 1) * out_channels], [inputs], **settings)

    def run(self, x: Tensor, weights: Tensor) -> Tensor:
        """Returns the outputs [*replicas, *batch, out_channels, height, width] with these weights.

        Args:
            x: inputs, [*replicas, *batch, in_channels, height, width].
            weights: [*replicas, *rows, P]: the kernel as in ``nn.Conv2d``, then the bias.
        """
        lead = weights.shape[:-1]
        rows = as_rows(x, lead, self.in_channels, "height", "width")
        count = prod(lead)
        flat = weights.reshape(count, -1)
        kernel, bias = flat.split([flat.shape[-1] - self.out_channels, self.out_channels], -1)
        # one grouped convolution runs all networks: each is a group of channels
        out = F.conv2d(
            rows.transpose(0, 1).flatten(1, 2),
            kernel.reshape(count * self.out_channels, self.in_channels, *self.kernel_size),
            bias.reshape(-1),
            self.stride,
            self.padding,
            groups=count,
        )
        out = out.unflatten(1, (count, self.out_channels)).transpose(0, 1)
        return out.reshape(*x.shape[:-3], *out.shape[-3:])

    def run_local(self, x: Tensor) -> Tensor:
        """Returns the outputs with a separate kernel for each row."""
        rows = x.shape[len(self.replicas) : -3]
        return self.run(x, self.draw_weights(rows))
