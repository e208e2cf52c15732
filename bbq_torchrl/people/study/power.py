"""How likely a study finds a difference, before anyone is invited."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np
from scipy import optimize, special, stats

from bbq_torchrl.people.study.statistics import sign_flip

LEVEL = 0.05
"""Of the tests."""


@dataclass(frozen=True)
class Power:
    """How often a difference was found.

    Attributes:
        sign_flip: share of simulated studies in which the declared test found it.
        fisher: the same of Fisher's exact test over all sessions.
        standard_error: of both, at most.
    """

    sign_flip: float
    fisher: float
    standard_error: float


def power(
    better: float,
    worse: float,
    people: int,
    *,
    sessions: int = 1,
    pairs: int = 1,
    person_sd: float = 0.0,
    simulations: int = 2_000,
    seed: int = 0,
) -> Power:
    """Simulates studies of two agents. Returns how often the difference is found.

    A person's log-odds of success with either agent are shifted by a normal draw of standard
    deviation ``person_sd``; the agents' mean success stays what is given. Holm is taken at its
    strictest: the pair must be significant at the level divided by their number.

    Args:
        better: success of one agent, between 0 and 1.
        worse: success of the other.
        people: how many; each meets both agents.
        sessions: of a person with each agent.
        pairs: how many pairs are declared.
        person_sd: how much people differ, in log-odds.
        simulations: how many studies.
        seed: of everything random.
    """
    rng = np.random.default_rng(seed)
    shift = person_sd * rng.standard_normal((simulations, people))
    won = [
        rng.binomial(sessions, special.expit(_center(rate, person_sd) + shift))
        for rate in (better, worse)
    ]
    level, count = LEVEL / pairs, people * sessions

    @cache
    def flipped(differences: tuple[int, ...]) -> float:
        return sign_flip([Fraction(value, sessions) for value in differences])

    @cache
    def exact(one: int, other: int) -> float:
        return stats.fisher_exact([[one, count - one], [other, count - other]]).pvalue

    # The test only sees how often each difference occurs.
    found = [flipped(tuple(row)) <= level for row in np.sort(won[0] - won[1]).tolist()]
    totals = zip(*(side.sum(1).tolist() for side in won), strict=True)
    fisher = [exact(*pair) <= level for pair in totals]
    return Power(float(np.mean(found)), float(np.mean(fisher)), 0.5 / simulations**0.5)


def _center(rate: float, person_sd: float) -> float:
    """Returns the log-odds that, shifted by people's normal draws, succeed at ``rate``."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)

    def excess(center: float) -> float:
        return np.average(special.expit(center + person_sd * nodes), weights=weights) - rate

    return optimize.brentq(excess, -50, 50)
