"""The keys of ``intrinsic=``: a reward of the agent's own besides the task's."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.config.settings import (
    COUNT,
    COUNTS,
    NON_NEGATIVE,
    POSITIVE,
    REQUIRED,
    Values,
    integers,
    one_of,
    option,
    per_replica,
    setting,
)

__all__ = ["IntrinsicConfig", "NoIntrinsicConfig", "VIMEConfig"]


@dataclass
class IntrinsicConfig:
    """What the agent is rewarded for besides the task; never part of a reported reward."""

    name: str = REQUIRED


@dataclass
class NoIntrinsicConfig(IntrinsicConfig):
    """The task's reward alone."""

    name: str = option("none")


@dataclass
class VIMEConfig(IntrinsicConfig):
    """What a transition teaches a Bayesian model of the dialogue's dynamics (VIME)."""

    name: str = option("vime")
    eta: Values = setting(
        0.1,
        per_replica(NON_NEGATIVE),
        "factor of the normalised information gain, in units of reward",
    )
    weights: str = setting(
        "map", one_of("map", "mc"), "information gain at the mean weights, or at one draw"
    )
    hidden: list[int] = setting([64, 64], COUNTS, "units of each hidden layer of the dynamics")
    prior_std: float = setting(0.1, POSITIVE, "std of the prior of the dynamics' weights")
    noise_std: float = setting(1.0, POSITIVE, "std of the standardised next state")
    std_floor: float = setting(0.05, POSITIVE, "least std that a feature is divided by")
    step_size: float = setting(0.01, POSITIVE, "size of the second-order step that gains")
    clip: float = setting(10.0, POSITIVE, "greatest normalised information gain")
    median_window: int = setting(
        10, integers(1, 10**6), "rounds that the normalising median is taken over"
    )
    dynamics_every: int = setting(8, COUNT, "updates of Q for one of the dynamics")
