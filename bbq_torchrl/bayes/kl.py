"""The KL divergence of any network that contains Bayesian layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.scope import KLSum

if TYPE_CHECKING:
    from torch import Tensor, nn

__all__ = ["kl_divergence", "posteriors"]


def posteriors(module: nn.Module) -> list[GaussianPosterior]:
    """Returns all posteriors in ``module``, in the order of its modules.

    Raises:
        ValueError: if there are none.

    Example:
        >>> from torch import nn
        >>> from bbq_torchrl.bayes import BayesLinear
        >>> from bbq_torchrl.bayes.kl import posteriors
        >>> len(posteriors(nn.Sequential(BayesLinear(3, 4), nn.Tanh(), BayesLinear(4, 2))))
        2
    """
    found = [m for m in module.modules() if isinstance(m, GaussianPosterior)]
    if not found:
        raise ValueError(
            f"{type(module).__name__} has no Bayesian layer: weight draws, their KL and Thompson "
            "sampling need a network with Bayesian layers (BayesMLP, BayesLinear, or any module "
            "that holds a GaussianPosterior)"
        )
    return found


def kl_divergence(module: nn.Module) -> Tensor:
    """Returns the closed KL from the prior over all posteriors in ``module``, [*replicas].

    Raises:
        ValueError: if the module has none.

    Example:
        >>> from bbq_torchrl.bayes import BayesMLP
        >>> bool((kl_divergence(BayesMLP(3, 2, replicas=5)) < 1e-3).all())
        True
    """
    kl = KLSum()
    kl.add(posteriors(module))
    return kl.total()
