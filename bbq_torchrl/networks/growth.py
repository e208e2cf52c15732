"""Networks whose inputs or outputs come into use later (domain extension).

There are two ways: grow a network when a feature or an action appears (:func:`grow`, the
paper's), or give it its full size at once, keep what is inactive at 0 and masked, and start the
inactive weights where growth would put them (:func:`reset_inactive_`). They are the same as long
as nothing moves an inactive weight: its data gradient is 0, and so is the gradient of the closed
KL at the prior. (A sampled KL moves it.)
"""

from __future__ import annotations

from copy import deepcopy

import torch
from torch import Tensor, nn

from bbq_torchrl.bayes.bayes_mlp import BayesMLP
from bbq_torchrl.bayes.functional import FlatLayout
from bbq_torchrl.networks.bootstrap_mlp import BootstrapMLP
from bbq_torchrl.networks.flat_mlp import FlatMLP
from bbq_torchrl.networks.noisy_mlp import NoisyMLP, noisy_layers

__all__ = ["grow", "grow_flat", "growth_index", "reset_inactive_"]


def growth_index(
    old: FlatLayout, new: FlatLayout, inputs: Tensor | None = None, outputs: Tensor | None = None
) -> Tensor:
    """Returns where each old weight lies in the grown flat vector, int64 [P_old].

    Args:
        old: layout before.
        new: layout after, with the same hidden sizes.
        inputs: where each old feature is among the new ones, int64 [in_old]; None for the first
            places.
        outputs: the same of the outputs, int64 [out_old].

    Raises:
        ValueError: if the hidden sizes differ, something shrinks, or an index does not fit.

    Example:
        >>> growth_index(FlatLayout((1, 2)), FlatLayout((2, 3)), outputs=torch.tensor([0, 2]))
        tensor([0, 2, 6, 8])
    """
    if old.sizes[1:-1] != new.sizes[1:-1]:
        raise ValueError(f"hidden sizes must stay {old.sizes[1:-1]}, got {new.sizes[1:-1]}")
    rows = _places("inputs", inputs, old.sizes[0], new.sizes[0])
    columns = _places("outputs", outputs, old.sizes[-1], new.sizes[-1])
    index, last = [], len(new.shapes) - 1
    for k, (matrix, bias) in enumerate(new.unflatten(torch.arange(new.numel))):
        row = rows if k == 0 else torch.arange(matrix.shape[0])
        column = columns if k == last else torch.arange(matrix.shape[1])
        index += [matrix[row][:, column].flatten(), bias[column]]
    return torch.cat(index)


def grow_flat(old: Tensor, new: Tensor, index: Tensor) -> Tensor:
    """Returns ``new`` [*replicas, P_new] with those of ``old`` [*replicas, P_old] at ``index``.

    For what goes along with the weights, such as Adam's moments (``new`` all 0).
    """
    index = index.to(old.device).expand(old.shape)
    return new.detach().scatter(-1, index, old.detach())


def grow(
    network: BayesMLP | FlatMLP,
    in_features: int,
    out_features: int,
    *,
    inputs: Tensor | None = None,
    outputs: Tensor | None = None,
) -> BayesMLP | FlatMLP:
    """Returns a larger copy of a network; outputs it had stay as they are where new inputs are 0.

    New input weights start at 0, in a Bayesian network at the prior (mean 0, std prior_std).
    The weights and bias of a new output start at the prior in a Bayesian network, else like
    ``nn.Linear``'s. The prior itself stays (with "fan_in": that of the sizes at first).

    Args:
        network: a BayesMLP or FlatMLP; not changed.
        in_features: new size of the input.
        out_features: new size of the output.

    Keyword Args:
        inputs: where each old feature is among the new ones, int64 [in_old]; None for the first
            places.
        outputs: the same of the outputs, int64 [out_old].

    Raises:
        ValueError: if something shrinks, an index does not fit, or the network is another one.

    Example:
        >>> import torch
        >>> from bbq_torchrl.networks import FlatMLP, grow
        >>> small = FlatMLP(2, 3, (8,))
        >>> large = grow(small, 4, 5, inputs=torch.tensor([0, 3]))
        >>> x = torch.randn(7, 2)
        >>> zeros = torch.zeros(7, 1)
        >>> y = large(torch.cat([x[:, :1], zeros, zeros, x[:, 1:]], 1))
        >>> y.shape, torch.allclose(y[:, :3], small(x))
        (torch.Size([7, 5]), True)
    """
    if not isinstance(network, (BayesMLP, FlatMLP)):
        raise ValueError(
            f"network must be a BayesMLP or FlatMLP to grow, got a "
            f"{type(network).__name__}: give it "
            "its full size and use reset_inactive_"
        )
    layout = FlatLayout((in_features, *network.layout.sizes[1:-1], out_features))
    index = growth_index(network.layout, layout, inputs, outputs)
    grown = deepcopy(network)
    grown.layout = layout
    if isinstance(grown, BayesMLP):
        posterior = grown.posterior
        posterior.group_sizes = layout.layer_sizes
        old = {"mu": posterior.mu, "rho": posterior.rho}
        for name, tensor in old.items():
            empty = tensor.new_empty((*posterior.replicas, layout.numel))
            setattr(posterior, name, nn.Parameter(empty, tensor.requires_grad))
        posterior.reset_parameters()
        for name, tensor in old.items():
            getattr(posterior, name).data = grow_flat(tensor, getattr(posterior, name), index)
        return grown
    weight = grown.weight
    grown.weight = nn.Parameter(
        weight.new_empty((*grown.replicas, layout.numel)), weight.requires_grad
    )
    grown.reset_parameters()
    old_inputs = _places("inputs", inputs, network.in_features, in_features)
    is_new = torch.ones(in_features, dtype=torch.bool)
    is_new[old_inputs] = False
    reset_inactive_(grown, inputs=is_new)
    grown.weight.data = grow_flat(weight, grown.weight, index)
    return grown


@torch.no_grad()
def reset_inactive_(
    network: BayesMLP | BootstrapMLP | FlatMLP | NoisyMLP,
    *,
    inputs: Tensor | None = None,
    outputs: Tensor | None = None,
) -> None:
    """Starts the weights of inactive inputs and outputs where :func:`grow` would put them.

    To be called once, before training, on a network of full size: it makes it the same as a
    network that grows (see above), also where ``mean_init`` or ``std_init`` start the other
    weights away from the prior.

    Args:
        network: a BayesMLP, BootstrapMLP, FlatMLP or NoisyMLP; changed in place. To be called
            before a loss copies the network, as a target updater leaves the copy of a prior
            function alone.

    Keyword Args:
        inputs: bool [in_features], True for the inactive ones: their weights become 0, in a
            Bayesian network the prior's (mean 0, std prior_std), in a noisy one μ and σ both:
            a feature that appears changes neither the mean nor the noise before it is learned.
            Those of a prior function become 0 too.
        outputs: bool [out_features], True for the inactive ones: the prior's in a Bayesian
            network; a plain or noisy one keeps the start it has (a noisy one tries a new
            action by the σ that it starts with).

    Raises:
        ValueError: if a mask has another shape.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, kl_divergence
        >>> from bbq_torchrl.networks.growth import reset_inactive_
        >>> net = BayesMLP(3, 2, (), mean_init="kaiming", std_init=0.01)
        >>> reset_inactive_(net, inputs=torch.tensor([False, True, True]))
        >>> net(torch.tensor([[0.0, 1.0, 0.0]])) - net(torch.zeros(1, 3))
        tensor([[0., 0.]], grad_fn=...)
    """
    if isinstance(network, BootstrapMLP):
        if outputs is not None:
            _mask("outputs", outputs, network.out_features)
        if inputs is not None:
            inactive = _mask("inputs", inputs, network.in_features).unsqueeze(-1)
            for matrix in network.input_matrices():
                matrix.masked_fill_(inactive.to(matrix.device), 0)
        return
    if isinstance(network, NoisyMLP):
        if outputs is not None:
            _mask("outputs", outputs, network.out_features)
        if inputs is not None:
            first = noisy_layers(network)[0]
            chosen = _mask("inputs", inputs, network.in_features).to(first.weight_mu.device)
            first.weight_mu.masked_fill_(chosen, 0)
            first.weight_sigma.masked_fill_(chosen, 0)
        return
    layout = network.layout
    affected = torch.zeros(layout.numel, dtype=torch.bool)
    layers = layout.unflatten(affected)
    if inputs is not None:
        layers[0][0][_mask("inputs", inputs, layout.sizes[0])] = True
    if outputs is not None:
        chosen = _mask("outputs", outputs, layout.sizes[-1])
        if isinstance(network, BayesMLP):
            layers[-1][0][:, chosen] = True
            layers[-1][1][chosen] = True
    if isinstance(network, BayesMLP):
        posterior = network.posterior
        affected = affected.to(posterior.mu.device)
        posterior.mu.masked_fill_(affected, 0)
        rho = posterior.per_weight(posterior.prior_rho)
        posterior.rho.copy_(torch.where(affected, rho, posterior.rho))
    else:
        network.weight.masked_fill_(affected.to(network.weight.device), 0)


def _places(name: str, index: Tensor | None, old: int, new: int) -> Tensor:
    if new < old:
        raise ValueError(f"{name} must not shrink: from {old} to {new}")
    if index is None:
        return torch.arange(old)
    index = index.cpu()
    is_valid = index.shape == (old,) and index.unique().numel() == old
    if not is_valid or index.min() < 0 or index.max() >= new:
        raise ValueError(f"{name} must be {old} different places below {new}, got {index.tolist()}")
    return index


def _mask(name: str, mask: Tensor, size: int) -> Tensor:
    if mask.dtype != torch.bool or mask.shape != (size,):
        raise ValueError(
            f"{name} must be a bool mask of shape [{size}], got {mask.dtype} {list(mask.shape)}"
        )
    return mask.cpu()
