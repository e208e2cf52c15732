"""Posteriors of weights, draws from them and their KL, and the layers made of them."""

from __future__ import annotations

from bbq_torchrl.bayes.bayes_mlp import BayesLinear, BayesMLP
from bbq_torchrl.bayes.functional import FlatLayout
from bbq_torchrl.bayes.held_std import held_std
from bbq_torchrl.bayes.kl import collect_kl, kl_divergence
from bbq_torchrl.bayes.noise_pool import noise_pool
from bbq_torchrl.bayes.posterior import GaussianPosterior
from bbq_torchrl.bayes.shared_noise import shared_noise
from bbq_torchrl.bayes.weight_mode import (
    given_weights,
    resolve_weight_mode,
    set_weight_mode,
    weight_mode,
)

__all__ = [
    "BayesLinear",
    "BayesMLP",
    "FlatLayout",
    "GaussianPosterior",
    "collect_kl",
    "given_weights",
    "held_std",
    "kl_divergence",
    "noise_pool",
    "resolve_weight_mode",
    "set_weight_mode",
    "shared_noise",
    "weight_mode",
]
