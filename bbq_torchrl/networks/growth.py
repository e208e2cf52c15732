"""Networks whose inputs or outputs come into use later (domain extension).

The paper grows a network when a feature or an action appears. Here it has its full size at once:
what is inactive is 0 and masked, and its weights start where growth would put them. The two are
the same as long as nothing moves an inactive weight: its data gradient is 0, and so is the
gradient of the closed KL at the prior. (A sampled KL moves it.)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.bayes.bayes_mlp import BayesMLP

if TYPE_CHECKING:
    from torch import Tensor

    from bbq_torchrl.networks.bootstrap_mlp import BootstrapMLP
    from bbq_torchrl.networks.flat_mlp import FlatMLP
    from bbq_torchrl.networks.noisy_mlp import NoisyMLP

__all__ = ["reset_inactive_"]


@torch.no_grad()
def reset_inactive_(
    network: BayesMLP | BootstrapMLP | FlatMLP | NoisyMLP,
    *,
    inputs: Tensor | None = None,
    outputs: Tensor | None = None,
) -> None:
    """Starts the weights of inactive inputs and outputs as if they were added only later.

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
    sizes = {"inputs": network.in_features, "outputs": network.out_features}
    for name, mask in (("inputs", inputs), ("outputs", outputs)):
        if mask is not None and (mask.dtype != torch.bool or mask.shape != (sizes[name],)):
            raise ValueError(
                f"{name} must be a bool mask of shape [{sizes[name]}], got {mask.dtype} "
                f"{list(mask.shape)}"
            )
    if isinstance(network, BayesMLP):
        posterior, layout = network.posterior, network.layout
        is_inactive = torch.zeros(layout.numel, dtype=torch.bool, device=posterior.mu.device)
        layers = layout.unflatten(is_inactive)
        if inputs is not None:
            layers[0][0][inputs] = True
        if outputs is not None:
            layers[-1][0][:, outputs] = True
            layers[-1][1][outputs] = True
        posterior.mu.masked_fill_(is_inactive, 0)
        rho = posterior.per_weight(posterior.prior_rho)
        posterior.rho.copy_(torch.where(is_inactive, rho, posterior.rho))
    elif inputs is not None:
        for matrix in network.input_matrices():
            matrix.masked_fill_(inputs.to(matrix.device).unsqueeze(-1), 0)
