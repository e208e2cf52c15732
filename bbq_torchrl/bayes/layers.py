"""Which Bayesian layers a module has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.bayes.bayes_mlp import BayesMLP

if TYPE_CHECKING:
    import torch

__all__ = ["bayesian_layers"]


def bayesian_layers(module: torch.nn.Module) -> list[BayesMLP]:
    """Returns the Bayesian layers and networks in ``module``.

    Raises:
        ValueError: if there are none.
    """
    layers = [m for m in module.modules() if isinstance(m, BayesMLP)]
    if not layers:
        raise ValueError(
            "Thompson sampling and weight draws need a network with Bayesian layers (BayesMLP, "
            "BayesLinear), got one without"
        )
    return layers
