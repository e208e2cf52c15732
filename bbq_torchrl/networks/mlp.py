"""Multi-layer perceptrons with a replica dimension: a plain one, and one with bootstrap heads."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from bbq_torchrl.bayes.functional import FlatLayout, as_rows, init_linear_, mlp, replica_shape
from bbq_torchrl.bayes.scope import WEIGHT_MODE, WeightMode, current_scope
from bbq_torchrl.settings import AT_LEAST_ZERO, BELOW_ONE, at_least, check


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


class BootstrapMLP(nn.Module):
    """A ReLU network with K heads (Osband et al., Bootstrapped DQN, 2016), or replicas of it.

    The heads share the first ``trunk_layers`` hidden layers. Their losses are summed, so a head
    learns as fast as a separate network. The gradient that they pass to the trunk, and through it
    to the input, is divided by K (section 6.1 of the paper).

    Args:
        in_features: size of the input.
        out_features: size of each head's output.
        hidden: sizes of the hidden layers. Defaults to (256, 256).

    Keyword Args:
        heads: the number K of heads. Defaults to 10.
        replicas: the number R of independent networks of K heads, or a shape; inputs have it as
            their leading dimensions. Defaults to (), one network.
        trunk_layers: the number of hidden layers that the heads share; 0 makes K separate networks.
            Defaults to None, all of them.
        prior_scale: if positive, the scale of a fixed network added to each head and initialized
            like the trained one (randomized prior functions, Osband et al. 2018). Heads then differ
            where data are missing. Defaults to 0.
        device: of the weights.
        dtype: of the weights.

    Attributes:
        trunk: parameter [*replicas, P_trunk], None without a trunk.
        heads: parameter [*replicas, K, P_head].
        prior_trunk: buffer of the trunk's shape, None without a trunk or a prior.
        prior_heads: buffer of the heads' shape, None without a prior.
        trunk_layout: layout of the trunk's weight vector, None without a trunk.
        head_layout: layout of each head's weight vector.

    Raises:
        ValueError: for an invalid argument.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.networks import BootstrapMLP
        >>> net = BootstrapMLP(268, 39, heads=10, replicas=5, prior_scale=1.0)
        >>> net(torch.ones(5, 32, 268)).shape
        torch.Size([5, 32, 10, 39])
        >>> [name for name, _ in net.named_parameters()]
        ['trunk', 'heads']
    """

    prior_trunk: Tensor | None
    prior_heads: Tensor | None

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int] = (256, 256),
        *,
        heads: int = 10,
        replicas: int | Sequence[int] = (),
        trunk_layers: int | None = None,
        prior_scale: float = 0.0,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        trunk_layers = len(hidden) if trunk_layers is None else trunk_layers
        check("heads", heads, at_least(1))
        if not 0 <= trunk_layers <= len(hidden):
            raise ValueError(
                f"trunk_layers must be from 0 to {len(hidden)}, the number of hidden layers, got "
                f"{trunk_layers}"
            )
        check("prior_scale", prior_scale, AT_LEAST_ZERO)
        self.in_features, self.out_features = in_features, out_features
        sizes = (in_features, *hidden, out_features)
        self.trunk_layout = FlatLayout(sizes[: trunk_layers + 1]) if trunk_layers else None
        self.head_layout = FlatLayout(sizes[trunk_layers:])
        self.replicas = replica_shape(replicas)
        self.num_heads = heads
        self.prior_scale = prior_scale

        def empty(layout: FlatLayout, *rows: int) -> Tensor:
            return torch.empty((*self.replicas, *rows, layout.numel), device=device, dtype=dtype)

        trunk, layout = self.trunk_layout, self.head_layout
        self.trunk = None if trunk is None else nn.Parameter(empty(trunk))
        self.heads = nn.Parameter(empty(layout, heads))
        has_prior = prior_scale > 0
        self.register_buffer("prior_trunk", empty(trunk) if trunk and has_prior else None)
        self.register_buffer("prior_heads", empty(layout, heads) if has_prior else None)
        self._init_linear_(self.prior_trunk, self.prior_heads)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draws the weights like ``nn.Linear``, uniform in ±1/√inputs; the priors are unchanged."""
        self._init_linear_(self.trunk, self.heads)

    def _init_linear_(self, trunk: Tensor | None, heads: Tensor | None) -> None:
        if trunk is not None and self.trunk_layout is not None:
            init_linear_(trunk, self.trunk_layout)
        if heads is not None:
            init_linear_(heads, self.head_layout)

    def reset_inactive_(self, inputs: Tensor, outputs: Tensor) -> None:
        """Sets the weights of inactive inputs to 0, those of the priors too.

        See :class:`bbq_torchrl.protocols.Growing`.
        """
        layout = self.trunk_layout or self.head_layout
        flats: tuple[Tensor | None, ...] = (self.heads, self.prior_heads)
        if self.trunk_layout is not None:
            flats = (self.trunk, self.prior_trunk)
        for flat in flats:
            if flat is not None:
                layout.unflatten(flat)[0][0][..., inputs, :] = 0

    def forward(self, x: Tensor) -> Tensor:
        """Returns the outputs of all heads, shape [*replicas, *batch, K, out].

        Args:
            x: inputs, shape [*replicas, *batch, in].

        Raises:
            ValueError: for a wrong shape.
        """
        as_rows(x, self.replicas, self.in_features)  # checks the shape
        out = self._run(x, self.trunk, self.heads)
        if self.prior_heads is not None:
            prior = self._run(x, self.prior_trunk, self.prior_heads)
            out = torch.add(out, prior, alpha=self.prior_scale)
        return out.movedim(len(self.replicas), -2)

    def _run(self, x: Tensor, trunk: Tensor | None, heads: Tensor) -> Tensor:
        """Returns [*replicas, K, *batch, out]."""
        dim = len(self.replicas)
        if trunk is not None and self.trunk_layout is not None:
            x = mlp(x, trunk, self.trunk_layout).relu()
            if torch.is_grad_enabled():
                # the same (finite) values with 1/K of the gradient, as the heads' gradients add up
                x = x.detach() + (x - x.detach()) / self.num_heads
        x = x.unsqueeze(dim).expand(*x.shape[:dim], self.num_heads, *x.shape[dim:])
        return mlp(x, heads, self.head_layout)
