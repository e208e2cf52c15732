"""The keys of ``agent=``: what learns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bbq_torchrl.config.settings import (
    ABOVE_ZERO_TO_ONE,
    BELOW_ONE,
    BOOLEAN,
    COUNT,
    COUNTS,
    NON_NEGATIVE,
    NON_NEGATIVE_INTEGER,
    POSITIVE,
    PROBABILITY,
    REQUIRED,
    STEP_SIZE,
    Values,
    one_of,
    option,
    optional,
    or_text,
    per_replica,
    setting,
)

__all__ = [
    "EVALUATION_MODES",
    "AgentConfig",
    "BBQNConfig",
    "BootstrapConfig",
    "DQNConfig",
]

EVALUATION_MODES = ("mean", "average", "draw", "thompson")
"""The policies that a Bayesian agent can be evaluated by."""


@dataclass
class AgentConfig:
    """What every agent has: a Q-network of two hidden layers of 256 units, trained by Adam."""

    name: str = REQUIRED
    hidden: list[int] = setting([256, 256], COUNTS, "units of each hidden layer")
    lr: Values = setting("${protocol.lr}", per_replica(STEP_SIZE), "step size of Adam")
    gamma: Values = setting(0.9, per_replica(PROBABILITY), "discount of a turn")


@dataclass
class BBQNConfig(AgentConfig):
    """Bayes-by-Backprop Q-network: a Gaussian for every weight and bias."""

    name: str = option("bbqn")
    prior_std: Any = setting(
        0.037,
        or_text(per_replica(POSITIVE), "fan_in"),
        "std of the prior; fan_in: sqrt(2 / fan-in) a layer",
    )
    mean_init: str = setting(
        "kaiming", one_of("zero", "kaiming"), "where the posterior means start"
    )
    std_init: Any = setting(
        0.09, optional(per_replica(POSITIVE), "prior_std"), "where the posterior stds start"
    )
    noise_std: Values = setting(
        1.0, per_replica(POSITIVE), "std of the noise on the target, in units of Q"
    )
    kl: str = setting("closed", one_of("closed", "sampled"), "how KL(q || p) is computed")
    kl_temperature: Values = setting(0.014, per_replica(NON_NEGATIVE), "factor on the KL term")
    target: str = setting(
        "map", one_of("map", "mc"), "target by the frozen posterior's mean, or by one draw of it"
    )
    target_noise: str | None = setting(
        None,
        optional(one_of("mean", "independent", "shared"), "mean for map, independent for mc"),
        "noise of the target's weights: none, its own, or that of the online draw",
    )
    evaluate: str = setting(
        "mean",
        one_of(*EVALUATION_MODES),
        "policy evaluated: mean network, average of draws, one draw, new draws at every step",
    )
    evaluate_draws: int = setting(10, COUNT, "draws that evaluate=average takes the mean of")


@dataclass
class DQNConfig(AgentConfig):
    """Deep Q-network, with or without dropout."""

    name: str = option("dqn")
    dropout: float = setting(
        0.0,
        BELOW_ONE,
        "probability of dropping a hidden unit in the prediction",
    )
    double: bool = setting(False, BOOLEAN, "choose the target's action by the online network")
    noisy: bool = setting(False, BOOLEAN, "NoisyNet layers in the place of dropout")


@dataclass
class BootstrapConfig(AgentConfig):
    """Bootstrapped DQN: heads that learn from a sample of the transitions each."""

    name: str = option("bootstrap")
    heads: int = setting(10, COUNT, "number of heads")
    trunk_layers: int | None = setting(
        None,
        optional(NON_NEGATIVE_INTEGER, "all hidden layers"),
        "hidden layers that the heads share; 0: as many networks as heads",
    )
    mask_prob: float = setting(
        0.5, ABOVE_ZERO_TO_ONE, "probability that a head learns from a transition"
    )
    prior_scale: float = setting(
        0.0, NON_NEGATIVE, "scale of the randomised prior functions; 0: none"
    )
    double: bool = setting(False, BOOLEAN, "choose the target's action by the online head")
