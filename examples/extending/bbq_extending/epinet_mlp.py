"""An epinet: a Q-network whose values also depend on an epistemic index."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from bbq_torchrl.networks import FlatMLP

if TYPE_CHECKING:
    from collections.abc import Sequence


class EpinetMLP(nn.Module):
    r"""A ReLU network with an epinet, or replicas of both (Osband et al., 2023).

    With the base network's last hidden features φ(x), which pass no gradient on, and an index z:

        Q(x, z) = base(x) + epinet(φ(x), z)ᵀ z + prior_scale · Σᵢ zᵢ prior_i(x).

    The priors are small networks that never learn, one for each dimension of the index. Where there
    are data the epinet learns to cancel them out; elsewhere values differ from index to index.

    Args:
        in_features: size of the input.
        out_features: size of the output.
        hidden: sizes of the base network's hidden layers, at least one.

    Keyword Args:
        index_size: dimensions of the index.
        epinet_hidden: sizes of the epinet's hidden layers.
        prior_hidden: sizes of the hidden layers of each prior.
        prior_scale: factor of the priors.
        replicas: R independent networks side by side, or a shape of them.
        device: of the weights.

    Examples:
        >>> network = EpinetMLP(3, 2, (16,), index_size=4, replicas=5)
        >>> x, index = torch.ones(5, 7, 3), torch.randn(5, 7, 4)
        >>> network(x, index).shape
        torch.Size([5, 7, 2])
        >>> [name for name, _ in network.named_parameters()]
        ['trunk.weight', 'head.weight', 'epinet.weight']
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int] = (256, 256),
        *,
        index_size: int = 8,
        epinet_hidden: Sequence[int] = (50,),
        prior_hidden: Sequence[int] = (16,),
        prior_scale: float = 1.0,
        replicas: int | Sequence[int] = (),
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__()
        size = {"replicas": replicas, "device": device}
        self.index_size = index_size
        self.prior_scale = prior_scale
        self.in_features, self.out_features = in_features, out_features
        self.trunk = FlatMLP(in_features, hidden[-1], hidden[:-1], **size)
        self.head = FlatMLP(hidden[-1], out_features, (), **size)
        self.epinet = FlatMLP(
            hidden[-1] + index_size, index_size * out_features, epinet_hidden, **size
        )
        self.priors = nn.ModuleList(
            FlatMLP(in_features, out_features, prior_hidden, **size) for _ in range(index_size)
        )
        for prior in self.priors:
            weight = prior.weight.detach()
            del prior.weight  # a buffer, which nothing learns
            prior.register_buffer("weight", weight)

    def forward(self, x: Tensor, index: Tensor) -> Tensor:
        """Returns the values, shape [*replicas, *batch, out].

        Args:
            x: inputs, shape [*replicas, *batch, in].
            index: shape [*replicas, *batch, index_size]; at 0 the values are the base network's.
        """
        features = self.trunk(x).relu()
        base = self.head(features)
        beside = self.epinet(torch.cat([features.detach(), index], -1))
        beside = beside.unflatten(-1, (self.index_size, self.out_features))
        return base + ((beside + self.prior_scale * self._priors(x)) * index.unsqueeze(-1)).sum(-2)

    @torch.no_grad()
    def _priors(self, x: Tensor) -> Tensor:
        """Returns the output of each prior network, [*replicas, *batch, index_size, out]."""
        return torch.stack([prior(x) for prior in self.priors], -2)

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Sets the weights of inputs that become active later to 0, in the priors too."""
        for network in (self.trunk, *self.priors):
            network.reset_inactive_(inputs, outputs)
