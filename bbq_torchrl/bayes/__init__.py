"""Weight posteriors, their draws and KL, and the layers built on them."""

from __future__ import annotations

from bbq_torchrl.bayes.bayes_mlp import BayesLinear, BayesMLP
from bbq_torchrl.bayes.layers import BayesConv2d, BayesLayer
from bbq_torchrl.bayes.posterior import GaussianPosterior, kl_divergence
from bbq_torchrl.bayes.scope import KLSum, weight_scope

__all__ = [
    "BayesConv2d",
    "BayesLayer",
    "BayesLinear",
    "BayesMLP",
    "GaussianPosterior",
    "KLSum",
    "kl_divergence",
    "weight_scope",
]
