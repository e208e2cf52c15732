"""Networks whose inputs or outputs come into use later (domain extension).

The paper grows a network when a feature or an action appears. Here it has its full size at once:
what is inactive is 0 and masked, and its weights start where growth would put them. The two are
the same as long as nothing moves an inactive weight: its data gradient is 0, and so is the
gradient of the closed KL at the prior. (A sampled KL moves it.)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.protocols import Growing, provides

if TYPE_CHECKING:
    from torch import Tensor


@torch.no_grad()
def reset_inactive_(
    network: Growing, *, inputs: Tensor | None = None, outputs: Tensor | None = None
) -> None:
    """Starts the weights of inactive inputs and outputs as if they were added only later.

    To be called once, before training, on a network of full size: it makes it the same as a
    network that grows (see above), also where ``mean_init`` or ``std_init`` start the other
    weights away from the prior.

    Args:
        network: changed in place. To be called before a loss copies the network, as a target
            updater leaves the copy of a prior function alone.

    Keyword Args:
        inputs: bool [in_features], True for the inactive ones: their weights become 0, in a
            Bayesian network the prior's (mean 0, std prior_std), in a noisy one μ and σ both:
            a feature that appears changes neither the mean nor the noise before it is learned.
            Those of a prior function become 0 too.
        outputs: bool [out_features], True for the inactive ones: the prior's in a Bayesian
            network; a plain or noisy one keeps the start it has (a noisy one tries a new
            action by the σ that it starts with).

    Raises:
        TypeError: if the network lacks what :class:`~bbq_torchrl.protocols.Growing` names.
        ValueError: if a mask has another shape.

    Examples:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, kl_divergence
        >>> from bbq_torchrl.networks.growth import reset_inactive_
        >>> net = BayesMLP(3, 2, (), mean_init="kaiming", std_init=0.01)
        >>> reset_inactive_(net, inputs=torch.tensor([False, True, True]))
        >>> net(torch.tensor([[0.0, 1.0, 0.0]])) - net(torch.zeros(1, 3))
        tensor([[0., 0.]], grad_fn=...)
    """
    if not provides(network, Growing):
        raise TypeError(
            f"{type(network).__name__} cannot start with inactive inputs or outputs: it needs "
            "in_features, out_features and reset_inactive_(inputs, outputs), as "
            "bbq_torchrl.protocols.Growing has them"
        )
    network.reset_inactive_(
        _mask("inputs", inputs, network.in_features),
        _mask("outputs", outputs, network.out_features),
    )


def _mask(name: str, mask: Tensor | None, size: int) -> Tensor:
    """Returns the mask, checked; all False for None."""
    if mask is None:
        return torch.zeros(size, dtype=torch.bool)
    if mask.dtype != torch.bool or mask.shape != (size,):
        raise ValueError(
            f"{name} must be a bool mask of shape [{size}], got {mask.dtype} {list(mask.shape)}"
        )
    return mask
