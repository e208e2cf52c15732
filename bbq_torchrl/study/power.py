"""How likely a study finds a difference, before anyone is invited."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy import special, stats

from bbq_torchrl.study.statistics import sign_flip

__all__ = ["Power", "power"]


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
    alpha: float = 0.05,
    simulations: int = 2_000,
    seed: int = 0,
) -> Power:
    """Simulates studies of two agents. Returns how often the difference is found.

    A person's log-odds of success with either agent are shifted by a normal draw of standard
    deviation ``person_sd``; the agents' mean success stays what is given. Holm is taken at its
    strictest: the pair must be significant at ``alpha / pairs``.

    Args:
        better: success of one agent, between 0 and 1.
        worse: success of the other.
        people: how many; each meets both agents.
        sessions: of a person with each agent.
        pairs: how many pairs are declared.
        person_sd: how much people differ, in log-odds.
        alpha: level of the tests.
        simulations: how many studies.
        seed: of everything random.
    """
    rng = np.random.default_rng(seed)
    shift = person_sd * rng.standard_normal((simulations, people))
    won = [
        rng.binomial(sessions, special.expit(_center(rate, person_sd) + shift))
        for rate in (better, worse)
    ]
    level = alpha / pairs
    known: dict[tuple[int, ...], float] = {}

    def flipped(row: np.ndarray) -> bool:
        # The test only sees how often each difference occurs.
        key = tuple(np.bincount(row + sessions, minlength=2 * sessions + 1).tolist())
        if key not in known:
            known[key] = sign_flip([Fraction(int(value), sessions) for value in row])
        return known[key] <= level

    found = np.mean([flipped(row) for row in won[0] - won[1]])
    totals = {tuple(pair) for pair in np.stack([side.sum(1) for side in won], 1).tolist()}
    count = people * sessions
    exact = {
        (one, other): stats.fisher_exact([[one, count - one], [other, count - other]]).pvalue
        for one, other in totals
    }
    sums = zip(won[0].sum(1).tolist(), won[1].sum(1).tolist(), strict=True)
    fisher = np.mean([exact[pair] <= level for pair in sums])
    return Power(float(found), float(fisher), 0.5 / simulations**0.5)


def _center(rate: float, person_sd: float) -> float:
    """Returns the log-odds that, shifted by people's normal draws, succeed at ``rate``."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    low, high = -50.0, 50.0
    for _ in range(100):
        center = (low + high) / 2
        share = float((special.expit(center + person_sd * nodes) * weights).sum() / weights.sum())
        low, high = (center, high) if share < rate else (low, center)
    return (low + high) / 2
