"""A plain multi-layer perceptron with a replica dimension and dropout."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from bbq_torchrl.bayes.functional import FlatLayout, init_linear_, mlp
from bbq_torchrl.bayes.replicas import replica_shape
from bbq_torchrl.bayes.scope import WEIGHT_MODE, WeightMode, current_scope
from bbq_torchrl.checks import BELOW_ONE, check

if TYPE_CHECKING:
    from collections.abc import Sequence


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
