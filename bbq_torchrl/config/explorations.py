"""The keys of ``explore=``: how an agent acts while it learns."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.config.settings import (
    BOOLEAN,
    POSITIVE,
    PROBABILITY,
    REQUIRED,
    Values,
    one_of,
    option,
    per_replica,
    setting,
)

__all__ = [
    "BoltzmannConfig",
    "BootstrapSamplingConfig",
    "EpsilonGreedyConfig",
    "ExploreConfig",
    "GreedyConfig",
    "NoisyConfig",
    "ThompsonConfig",
    "ThompsonEpsilonConfig",
]


@dataclass
class ExploreConfig:
    """What every exploration strategy has."""

    name: str = REQUIRED


@dataclass
class ThompsonConfig(ExploreConfig):
    """Draw weights from the posterior and act greedily on them."""

    name: str = option("thompson")
    per: str = setting(
        "step", one_of("step", "dialogue", "round"), "how long one draw of the weights is kept"
    )
    shared: bool = setting(False, BOOLEAN, "one draw for all dialogues that run side by side")


@dataclass
class EpsilonGreedyConfig(ExploreConfig):
    """With probability epsilon a uniformly random legal action, else the greedy one."""

    name: str = option("epsilon_greedy")
    eps_init: Values = setting(0.04, per_replica(PROBABILITY), "epsilon in the first round")
    eps_end: Values = setting(
        0.01, per_replica(PROBABILITY), "epsilon from the last annealed round on"
    )
    anneal_fraction: float = setting(
        0.5, PROBABILITY, "share of the rounds over which epsilon falls, linearly"
    )


@dataclass
class ThompsonEpsilonConfig(ExploreConfig):
    """Thompson sampling, and with probability epsilon a uniformly random legal action."""

    name: str = option("thompson_epsilon")
    per: str = setting(
        "step", one_of("step", "dialogue", "round"), "how long one draw of the weights is kept"
    )
    shared: bool = setting(False, BOOLEAN, "one draw for all dialogues that run side by side")
    eps_init: Values = setting(0.04, per_replica(PROBABILITY), "epsilon in the first round")
    eps_end: Values = setting(
        0.01, per_replica(PROBABILITY), "epsilon from the last annealed round on"
    )
    anneal_fraction: float = setting(
        0.5, PROBABILITY, "share of the rounds over which epsilon falls, linearly"
    )


@dataclass
class GreedyConfig(ExploreConfig):
    """The action of the highest Q-value; no exploration."""

    name: str = option("greedy")


@dataclass
class BoltzmannConfig(ExploreConfig):
    """Actions drawn from softmax(Q / temperature)."""

    name: str = option("boltzmann")
    temperature_init: Values = setting(
        0.7, per_replica(POSITIVE), "temperature in the first round, units of Q"
    )
    temperature_end: Values = setting(
        0.7, per_replica(POSITIVE), "temperature from the last annealed round on"
    )
    anneal_fraction: float = setting(
        0.5, PROBABILITY, "share of the rounds over which the temperature falls, linearly"
    )


@dataclass
class BootstrapSamplingConfig(ExploreConfig):
    """Act greedily on one of the heads, drawn for every dialogue."""

    name: str = option("bootstrap")
    per: str = setting(
        "dialogue", one_of("step", "dialogue", "round"), "how long one draw of a head is kept"
    )


@dataclass
class NoisyConfig(ExploreConfig):
    """Act greedily on one draw of the NoisyNet's noise a step."""

    name: str = option("noisy")
    shared: bool = setting(False, BOOLEAN, "one draw for all dialogues that run side by side")
