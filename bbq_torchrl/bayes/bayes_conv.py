"""A Bayes-by-Backprop convolution."""

from __future__ import annotations

from math import prod
from operator import index
from typing import TYPE_CHECKING, SupportsIndex

import torch.nn.functional as F

from bbq_torchrl.bayes.functional import as_rows
from bbq_torchrl.bayes.layers import BayesLayer, LayerSettings

if TYPE_CHECKING:
    from torch import Tensor
    from typing_extensions import Unpack


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
            √(2/(in_channels · kernel)). Defaults to 0.037.
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
            kernel: tuple[int, ...] = (index(kernel_size), index(kernel_size))
        else:
            kernel = tuple(kernel_size)
        if min(in_channels, out_channels, *kernel) < 1:
            raise ValueError(
                "in_channels, out_channels and kernel_size must be positive, got "
                f"{in_channels}, {out_channels} and {kernel_size}"
            )
        self.in_channels, self.out_channels = in_channels, out_channels
        self.kernel_size = kernel
        self.stride, self.padding = stride, padding
        inputs = in_channels * prod(kernel)
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

    def extra_repr(self) -> str:
        """Returns the sizes for ``repr``."""
        return (
            f"{self.in_channels}, {self.out_channels}, kernel_size={self.kernel_size}, "
            f"stride={self.stride}, padding={self.padding}, replicas={tuple(self.replicas)}"
        )
