"""Standard deviations of posteriors that do not change for a while, computed once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.bayes.context import Context

if TYPE_CHECKING:
    from torch import Tensor

    from bbq_torchrl.bayes.posterior import GaussianPosterior

__all__ = ["held_std", "std_of"]


class held_std(Context):
    """Makes the weight draws inside of each ``with`` block on this object use the same σ.

    softplus(ρ) of all weights costs as much as their noise, and that of a frozen posterior is
    the same from one freeze to the next. The σ of a posterior is computed at its first draw in
    a block, without a gradient in ρ, and used by the later ones, also with other parameters in
    place, until :meth:`clear`.

    Example:
        >>> import torch
        >>> from bbq_torchrl.bayes import BayesMLP, held_std
        >>> net, x, std = BayesMLP(3, 2), torch.ones(3), held_std()
        >>> with std:
        ...     _ = net(x, "draw")
        >>> net.posterior.reset_std_(1e-9)
        >>> with std:
        ...     bool((net(x, "draw") == 0).all())
        False
    """

    def __init__(self) -> None:
        self._stds: dict[GaussianPosterior, Tensor] = {}

    def clear(self) -> None:
        """Forgets what is held."""
        self._stds.clear()

    def of(self, posterior: GaussianPosterior) -> Tensor:
        """Returns a posterior's standard deviations, [*stack, P]."""
        std = self._stds.get(posterior)
        if std is None:
            std = self._stds[posterior] = posterior.sigma.detach()
        return std


def std_of(posterior: GaussianPosterior) -> Tensor:
    """Returns a posterior's standard deviations [*stack, P]; those held inside of `held_std`.

    Args:
        posterior: outside of :class:`held_std` the result is differentiable in its rho.
    """
    held = held_std.active()
    return posterior.sigma if held is None else held.of(posterior)
