"""Comparisons of two agents: the declared test, the usual ones, and their power."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import optimize, special, stats

from bbq_torchrl.people.study.records import HIGHEST, LOWEST
from bbq_torchrl.utils.statistics import ALPHA, PValue, holm, participant_mean, sign_flip

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from bbq_torchrl.people.study.results import Results
    from bbq_torchrl.utils.statistics import Estimate


class Difference(NamedTuple):
    """Participants' differences between two agents, in success or in the overall rating.

    Attributes:
        people: the number of participants who have sessions with both.
        mean: their mean difference, with its interval.
        p: the p-value of the sign-flip test.
        holm: the same, adjusted for all declared pairs.
    """

    people: int
    mean: Estimate
    p: PValue
    holm: PValue


class Comparison(NamedTuple):
    """A declared pair.

    Attributes:
        better: the agent declared first.
        worse: the other.
        success: the difference in success.
        rating: the difference in the overall rating.
        fisher: Fisher's exact p-value over all sessions of the two.
        boschloo: Boschloo's exact p-value over the same.
        mann_whitney: the Mann-Whitney p-value over all ratings of the two.
    """

    better: str
    worse: str
    success: Difference
    rating: Difference
    fisher: PValue
    boschloo: PValue
    mann_whitney: PValue


def compare_pairs(results: Results, without: Collection[str] = ()) -> list[Comparison]:
    """Returns the comparison of every declared pair.

    Args:
        results: the study's results.
        without: participants to leave out.
    """
    kept = [session for session in results.sessions if session.person not in without]
    results = replace(results, sessions=tuple(kept))
    success = _differences(results, results.successes, 1)
    rating = _differences(results, results.ratings, HIGHEST - LOWEST)
    compared = []
    for (better, worse), in_success, in_rating in zip(
        results.terms.pairs, success, rating, strict=True
    ):
        won = [list(chain(*results.successes(agent).values())) for agent in (better, worse)]
        rated = [list(chain(*results.ratings(agent).values())) for agent in (better, worse)]
        table = [[sum(side), len(side) - sum(side)] for side in won]
        tests = (
            stats.fisher_exact(table),
            stats.boschloo_exact(table),
            stats.mannwhitneyu(*rated) if all(rated) else None,
        )
        p_values = [PValue(math.nan if test is None else test.pvalue) for test in tests]
        compared.append(Comparison(better, worse, in_success, in_rating, *p_values))
    return compared


def _differences(
    results: Results, of: Callable[[str], Mapping[str, Sequence[int]]], most: int
) -> list[Difference]:
    """Returns, for each pair, participants' means with one agent minus those with the other.

    The differences lie between ``-most`` and ``most``.
    """
    pairs = []
    for pair in results.terms.pairs:
        one, other = (
            {person: Fraction(sum(v), len(v)) for person, v in of(agent).items()} for agent in pair
        )
        pairs.append([one[person] - other[person] for person in sorted(one.keys() & other.keys())])
    p = list(map(sign_flip, pairs))
    return [
        Difference(
            len(values),
            participant_mean([[float(value)] for value in values], (-most, most)),
            PValue(own),
            PValue(adjusted),
        )
        for values, own, adjusted in zip(pairs, p, holm(p), strict=True)
    ]


@dataclass(frozen=True)
class Power:
    """Shares of simulated studies that found the difference.

    Attributes:
        sign_flip: share of simulated studies in which the declared test found it.
        fisher: the same for Fisher's exact test over all sessions.
        standard_error: upper bound on the standard error of both.
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
    """Simulates studies of two agents. Returns how often they find the difference.

    A participant's log-odds of success with either agent are shifted by a normal draw of standard
    deviation ``person_sd``; the agents' mean success stays as given. Holm's adjustment is taken at
    its strictest: the pair must be significant at the level divided by the number of pairs.

    Args:
        better: success of one agent, between 0 and 1.
        worse: success of the other.
        people: the number of participants; each meets both agents.
        sessions: the number of sessions of a participant with each agent.
        pairs: the number of declared pairs.
        person_sd: standard deviation between participants, in log-odds.
        simulations: the number of simulated studies.
        seed: the random seed.
    """
    rng = np.random.default_rng(seed)
    shift = person_sd * rng.standard_normal((simulations, people))
    won = [
        rng.binomial(sessions, special.expit(_center(rate, person_sd) + shift))
        for rate in (better, worse)
    ]
    level, count = ALPHA / pairs, people * sessions

    @cache
    def flipped(differences: tuple[int, ...]) -> float:
        return sign_flip([Fraction(value, sessions) for value in differences])

    @cache
    def exact(one: int, other: int) -> float:
        return stats.fisher_exact([[one, count - one], [other, count - other]]).pvalue

    # The test depends only on how often each difference occurs.
    found = [flipped(tuple(row)) <= level for row in np.sort(won[0] - won[1]).tolist()]
    totals = zip(*(side.sum(1).tolist() for side in won), strict=True)
    fisher = [exact(*pair) <= level for pair in totals]
    return Power(float(np.mean(found)), float(np.mean(fisher)), 0.5 / simulations**0.5)


def _center(rate: float, person_sd: float) -> float:
    """Returns the log-odds that succeed at ``rate`` once shifted by participants' normal draws."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)

    def excess(center: float) -> float:
        return np.average(special.expit(center + person_sd * nodes), weights=weights) - rate

    return optimize.brentq(excess, -50, 50)
