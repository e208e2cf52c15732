"""Networks whose inputs or outputs come into use later (domain extension).

The paper grows a network when a feature or an action appears. Here the network has its full size
from the start: inactive features are 0, inactive actions are masked, and their weights start where
growth would put them. The two are equivalent as long as nothing moves an inactive weight. Its data
gradient is 0, and so is the gradient of the closed KL at the prior. (A sampled KL moves it.)
"""

from __future__ import annotations

import torch
from torch import Tensor

from bbq_torchrl.protocols import Growing, provides


@torch.no_grad()
def reset_inactive_(
    network: Growing, *, inputs: Tensor | None = None, outputs: Tensor | None = None
) -> None:
    """Initializes the weights of inactive inputs and outputs as if they were added later.

    Call it once, before training, on a network of full size. The network is then equivalent to one
    that grows (see above), even if ``mean_init`` or ``std_init`` start the other weights away from
    the prior.

    Args:
        network: the network, changed in place. Call this before a loss copies the network, because
            target updaters do not update the copy of a prior function.

    Keyword Args:
        inputs: bool [in_features], True for inactive inputs. Their weights become 0 (in a noisy
            network μ and σ), or those of the prior in a Bayesian network (mean 0, std prior_std).
            So a new feature changes neither the mean nor the noise before it is learned. The
            weights of a prior function become 0 too.
        outputs: bool [out_features], True for inactive outputs. Their weights become the prior's in
            a Bayesian network. A plain or noisy network keeps its initial weights; a noisy one
            explores a new action by its initial σ.

    Raises:
        TypeError: if the network does not implement :class:`~bbq_torchrl.protocols.Growing`.
        ValueError: if a mask has the wrong shape.

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
            "in_features, out_features and reset_inactive_(inputs, outputs), see "
            "bbq_torchrl.protocols.Growing"
        )
    network.reset_inactive_(
        _mask("inputs", inputs, network.in_features),
        _mask("outputs", outputs, network.out_features),
    )


def _mask(name: str, mask: Tensor | None, size: int) -> Tensor:
    """Returns the checked mask; all False for None."""
    if mask is None:
        return torch.zeros(size, dtype=torch.bool)
    if mask.dtype != torch.bool or mask.shape != (size,):
        raise ValueError(
            f"{name} must be a bool mask of shape [{size}], got {mask.dtype} {list(mask.shape)}"
        )
    return mask
