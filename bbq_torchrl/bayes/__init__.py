"""Posteriors of weights, draws from them and their KL, and the layers made of them."""

from __future__ import annotations

from bbq_torchrl.bayes.bayes_conv import BayesConv2d
from bbq_torchrl.bayes.bayes_gru import BayesGRU
from bbq_torchrl.bayes.bayes_mlp import BayesLinear, BayesMLP
from bbq_torchrl.bayes.functional import FlatLayout
from bbq_torchrl.bayes.kl import kl_divergence, posteriors
from bbq_torchrl.bayes.layers import BayesLayer
from bbq_torchrl.bayes.noise_sources import NoisePool, NoiseSource, SharedNoise
from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.replicas import replica_shape
from bbq_torchrl.bayes.scope import (
    KLSum,
    WeightScope,
    current_scope,
    resolve_weight_mode,
    weight_scope,
)

__all__ = [
    "BayesConv2d",
    "BayesGRU",
    "BayesLayer",
    "BayesLinear",
    "BayesMLP",
    "FlatLayout",
    "GaussianPosterior",
    "KLSum",
    "NoisePool",
    "NoiseSource",
    "SharedNoise",
    "WeightScope",
    "current_scope",
    "kl_divergence",
    "posteriors",
    "replica_shape",
    "resolve_weight_mode",
    "weight_scope",
]
