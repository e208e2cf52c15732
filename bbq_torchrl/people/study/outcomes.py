"""Outcomes of a study so far: its ended sessions, with estimates and tests over participants."""

from __future__ import annotations

import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import chain, pairwise, starmap
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy import optimize, special, stats

from bbq_torchrl.people.study.database import (
    EXCHANGES,
    HIGHEST,
    LOWEST,
    NOT_FORGOTTEN,
    SESSIONS,
    Exchange,
    Session,
    opened,
)
from bbq_torchrl.people.study.plan import Terms
from bbq_torchrl.utils.statistics import (
    ALPHA,
    CONFIDENCE,
    ROUNDING,
    Estimate,
    PValue,
    estimate,
    holm,
)

Value = TypeVar("Value")

FAST_SECONDS = 2.0
"""A participant who mostly replies sooner has hardly read the answers."""


@dataclass(frozen=True)
class Outcome(Session):
    """An ended session; its person is an anonymous name: ``P1``, ``P2``, ...

    Attributes:
        exchanges: the session's exchanges.
    """

    exchanges: tuple[Exchange, ...]

    def entropy(self, first: int | None = None) -> float | None:
        """Returns the mean entropy of the best action; ``None`` without a posterior.

        Args:
            first: the number of exchanges, or ``None`` for all.
        """
        found = [item.beliefs["entropy"] for item in self.exchanges[:first] if item.beliefs]
        return fmean(found) if found else None


@dataclass(frozen=True)
class Outcomes:
    """A study's outcomes.

    Attributes:
        terms: the declared terms.
        package: the version of the package that it runs with.
        simulated: whether the participants are simulated users.
        enrolled: the number of participants enrolled.
        open: the number of sessions that have begun and not ended.
        sessions: the ended sessions.
    """

    terms: Terms
    package: str
    simulated: bool
    enrolled: int
    open: int
    sessions: tuple[Outcome, ...]

    def by_person(
        self, of: Callable[[Outcome], Value | None], agent: str | None = None
    ) -> dict[str, list[Value]]:
        """Returns values of each participant's sessions, where available.

        Args:
            of: returns the value of a session, or ``None``.
            agent: the agent of the sessions; ``None`` for all agents.
        """
        found: dict[str, list[Value]] = defaultdict(list)
        for session in self.sessions:
            if agent in (None, session.agent) and (value := of(session)) is not None:
                found[session.person].append(value)
        return dict(found)

    def successes(self, agent: str) -> dict[str, list[bool]]:
        """Returns the judge's verdicts on an agent by participant."""
        return self.by_person(lambda session: session.success, agent)

    def ratings(self, agent: str, scale: str = "overall") -> dict[str, list[int]]:
        """Returns an agent's ratings by participant."""
        return self.by_person(lambda item: item.ratings[scale] if item.ratings else None, agent)

    def flags(self) -> dict[str, list[str]]:
        """Returns the flags of conspicuous participants; nobody is excluded for them."""
        people = self.by_person(lambda session: session)
        by_number = sorted(people, key=lambda person: int(person.removeprefix("P")))
        return {person: flags for person in by_number if (flags := _flags(people[person]))}


def _flags(sessions: Sequence[Outcome]) -> list[str]:
    pairs = chain(*(pairwise(session.exchanges) for session in sessions))
    pauses = [after.at - before.at for before, after in pairs]
    ratings = [list(session.ratings.values()) for session in sessions if session.ratings]
    checks = {
        f"too fast: mostly under {FAST_SECONDS:g} s between answer and message": (
            len(pauses) > 2 and median(pauses) < FAST_SECONDS
        ),
        "always the same rating": len(ratings) > 1 and len(set(chain(*ratings))) == 1,
        "one message a conversation": all(len(session.exchanges) < 2 for session in sessions),
    }
    return [flag for flag, holds in checks.items() if holds]


def read_outcomes(data: Path) -> Outcomes:
    """Returns the outcomes in a study's file, even while it is being served.

    Args:
        data: the SQLite file.

    Raises:
        StoreError: it cannot be read.
    """
    with opened(data) as connection:
        terms, package, simulated = connection.execute(
            "SELECT terms, package, simulated FROM study"
        ).fetchone()
        people = connection.execute(f"SELECT id, token FROM person {NOT_FORGOTTEN}").fetchall()
        names = report_names(people)
        sessions = list(starmap(Session, connection.execute(f"{SESSIONS} ORDER BY session.id")))
        ended = []
        for session in sessions:
            if session.is_ended:
                exchanges = starmap(Exchange, connection.execute(EXCHANGES, (session.id,)))
                about = {**vars(session), "person": names[session.person]}
                ended.append(Outcome(**about, exchanges=tuple(exchanges)))
    return Outcomes(
        terms=Terms(**json.loads(terms)),
        package=package,
        simulated=bool(simulated),
        enrolled=len(people),
        open=sum(session.messages > 0 and not session.is_ended for session in sessions),
        sessions=tuple(ended),
    )


def report_names(people: Sequence[tuple[int, str]]) -> dict[str, str]:
    """Returns the names in a report by participant number; they do not reveal who came when.

    Args:
        people: each participant's number and link hash, without forgotten participants.
    """
    by_chance = sorted(people, key=lambda person: hashlib.sha256(person[1].encode()).digest())
    return {str(person): f"P{number}" for number, (person, _) in enumerate(by_chance, start=1)}


class Difference(NamedTuple):
    """Participants' differences between the two agents of a declared pair.

    Attributes:
        pair: the agents' names.
        people: the number of participants who have sessions with both.
        mean: their mean difference, with its interval.
        p: the p-value of the sign-flip test.
        holm: the same, adjusted for all declared pairs.
        classical: p-values of the usual tests, which treat sessions as independent, by name.
    """

    pair: str
    people: int
    mean: Estimate
    p: PValue
    holm: PValue
    classical: Mapping[str, PValue]


def compare_pairs(
    outcomes: Outcomes, quantity: str, without: Collection[str] = ()
) -> list[Difference]:
    """Returns, for each declared pair, the difference of participants' means.

    Args:
        outcomes: the study's outcomes.
        quantity: ``success`` or ``rating``, the overall one.
        without: participants to leave out.
    """
    kept = [session for session in outcomes.sessions if session.person not in without]
    outcomes = replace(outcomes, sessions=tuple(kept))
    of: Callable[[str], Mapping[str, Sequence[int]]] = outcomes.successes
    most, classical = 1, _exact_tests
    if quantity == "rating":
        of, most, classical = outcomes.ratings, HIGHEST - LOWEST, _rank_test
    differences, tests = [], []
    for pair in outcomes.terms.pairs:
        one, other = map(of, pair)
        both = sorted(one.keys() & other.keys())
        differences.append([_mean(one[person]) - _mean(other[person]) for person in both])
        found = classical(list(chain(*one.values())), list(chain(*other.values())))
        tests.append({name: PValue(p) for name, p in found.items()})
    p_values = list(map(sign_flip, differences))
    means = [
        participant_mean([[float(value)] for value in values], (-most, most))
        for values in differences
    ]
    return [
        Difference(" – ".join(pair), len(values), mean, PValue(p), PValue(adjusted), others)
        for pair, values, mean, p, adjusted, others in zip(
            outcomes.terms.pairs, differences, means, p_values, holm(p_values), tests, strict=True
        )
    ]


def _mean(values: Sequence[int]) -> Fraction:
    return Fraction(sum(values), len(values))


def _exact_tests(one: Sequence[int], other: Sequence[int]) -> dict[str, float]:
    table = [[sum(side), len(side) - sum(side)] for side in (one, other)]
    fisher, boschloo = stats.fisher_exact(table), stats.boschloo_exact(table)
    return {"Fisher": fisher.pvalue, "Boschloo": boschloo.pvalue}


def _rank_test(one: Sequence[int], other: Sequence[int]) -> dict[str, float]:
    p_value = stats.mannwhitneyu(one, other).pvalue if one and other else math.nan
    return {"Mann-Whitney": p_value}


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
) -> float:
    """Simulates studies of two agents. Returns how often the declared test finds the difference.

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

    @cache
    def p_value(differences: tuple[int, ...]) -> float:
        return sign_flip([Fraction(value, sessions) for value in differences])

    # The test depends only on how often each difference occurs.
    rows = np.sort(won[0] - won[1]).tolist()
    return fmean(p_value(tuple(row)) <= ALPHA / pairs for row in rows)


def _center(rate: float, person_sd: float) -> float:
    """Returns the log-odds that succeed at ``rate`` once shifted by participants' normal draws."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)

    def excess(center: float) -> float:
        return np.average(special.expit(center + person_sd * nodes), weights=weights) - rate

    return optimize.brentq(excess, -50, 50)


_MAX_SUMS = 5_000_000
_RANDOM_FLIPS = 99_999
_RESAMPLES = 2_000


def proportion(by_person: Collection[Sequence[bool]]) -> Estimate:
    """Returns the share of participants' sessions that succeed.

    The interval is Wilson's if nobody has several sessions, else that of :func:`participant_mean`.

    Args:
        by_person: each participant's successes and failures.

    Examples:
        >>> print(proportion([[True]] * 40 + [[False]] * 26))
        0.61 [0.49, 0.71]
    """
    sessions = list(chain(*by_person))
    if not sessions or any(len(person) > 1 for person in by_person):
        return participant_mean(by_person, (0.0, 1.0))
    found = stats.binomtest(sum(sessions), len(sessions)).proportion_ci(CONFIDENCE, "wilson")
    value = fmean(sessions)
    # Rounding must not put a rate of 0 or 1 outside its interval.
    return Estimate(value, min(value, float(found.low)), max(value, float(found.high)), ".2f")


def participant_mean(
    by_person: Collection[Sequence[float]], bounds: tuple[float, float]
) -> Estimate:
    """Returns the mean of participants' means, with a Student t interval if there are several.

    If that interval exceeds ``bounds``, or has no width because all participants are alike, two
    participants are added, one at each bound, and the new interval is clipped to ``bounds``.
    Bonett and Price (2012) adjust the interval of a difference of paired rates like this.

    Args:
        by_person: each participant's values.
        bounds: the smallest and the largest possible value.

    Examples:
        >>> print(participant_mean([[5.0], [5.0], [5.0]], (1, 5)))
        5.00 [1.98, 5.00]
    """
    means = [fmean(person) for person in by_person if person]
    if not means:
        return Estimate(math.nan)
    found = estimate(means, ".2f", bounds=bounds)
    if found.low == bounds[0] or found.high == bounds[1] or found.low == found.high:
        more = estimate([*means, *bounds], bounds=bounds)
        low, high = min(found.value, more.low), max(found.value, more.high)
        return Estimate(found.value, low, high, ".2f")
    return found


def kappa(by_person: Sequence[Sequence[tuple[bool, bool]]]) -> Estimate:
    """Returns Cohen's κ of two judges with its interval by :func:`bootstrap`.

    Args:
        by_person: each participant's pairs of verdicts.

    Returns:
        The estimate; NaN if all verdicts are the same, which leaves no agreement beyond chance.
    """
    all_verdicts = [(True, True), (True, False), (False, True), (False, False)]
    return bootstrap(_kappa, by_person, [all_verdicts])


def _kappa(verdicts: Any, counts: Any) -> Any:
    total = counts.sum(-1)
    agreed = counts @ (verdicts[:, 0] == verdicts[:, 1]) / total
    one, other = (counts @ verdicts).T / total
    chance = one * other + (1 - one) * (1 - other)
    return (agreed - chance) / (1 - chance)


def auroc(by_person: Sequence[Sequence[tuple[float, bool]]]) -> Estimate:
    """Returns the probability that a failure scores higher than a success, ties counting half.

    Args:
        by_person: each participant's sessions, with score and whether they failed.

    Returns:
        The estimate with its interval by :func:`bootstrap`; NaN without failures or without
        successes.
    """
    return bootstrap(_auroc, by_person, [[(math.inf, True)], [(-math.inf, True)]])


def _auroc(sessions: Any, counts: Any) -> Any:
    scores, has_failed = sessions[:, 0], sessions[:, 1] == 1
    wins = (np.sign(np.subtract.outer(scores[has_failed], scores[~has_failed])) + 1) / 2
    failures, successes = counts[:, has_failed], counts[:, ~has_failed]
    return ((failures @ wins) * successes).sum(-1) / (failures.sum(-1) * successes.sum(-1))


def bootstrap(
    statistic: Callable[[Any, Any], Any],
    by_person: Sequence[Sequence[tuple[float, float]]],
    doubtful: Sequence[Sequence[tuple[float, float]]],
) -> Estimate:
    """Returns a statistic with its 95 % percentile bootstrap interval over participants.

    Args:
        statistic: from the values of sessions, shape [sessions, 2], and from how often each is
            drawn, shape [samples, sessions], to [samples]; NaN where it is undefined.
        by_person: the values of each participant's sessions.
        doubtful: participants who are added if all resamples are equal, such as those of a few
            sessions that all agree: they give the interval a width.
    """
    people = [person for person in by_person if person]
    if not people:
        return Estimate(math.nan)
    with np.errstate(invalid="ignore"):
        value = float(statistic(*_sessions(people, np.ones((1, len(people)))))[0])
        if math.isnan(value) or len(people) < 2:
            return Estimate(value, spec=".2f")
        for drawn_from in (people, [*people, *doubtful]):
            count = len(drawn_from)
            times = np.random.default_rng(0).multinomial(count, [1 / count] * count, _RESAMPLES)
            drawn = statistic(*_sessions(drawn_from, times))
            ends = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
            low, high = np.nanquantile(drawn, ends).tolist()
            if high - low > ROUNDING:
                break
    return Estimate(value, min(low, value), max(high, value), ".2f")


def _sessions(people: Sequence[Sequence[tuple[float, float]]], times: Any) -> tuple[Any, Any]:
    """Returns the values of all sessions, and how often each is drawn when people are."""
    whose = np.repeat(range(len(people)), [len(person) for person in people])
    return np.array([*chain(*people)], dtype=float), times[:, whose]


def sign_flip(differences: Sequence[Fraction]) -> float:
    """Returns the two-sided p-value of the sign-flip permutation test of a mean of 0.

    If two agents are alike, a participant's difference between them is as likely as its opposite:
    p is the share of all sign flips whose sum is at least as far from 0. All sign flips are
    counted, or 99,999 random ones (by SciPy) if the denominators have too little in common.

    Args:
        differences: one for each participant.

    Examples:
        >>> from fractions import Fraction
        >>> sign_flip([Fraction(1)] * 6)
        0.03125
    """
    weights = [difference for difference in differences if difference]
    scale = math.lcm(*(weight.denominator for weight in weights))
    sizes = [abs(int(weight * scale)) for weight in weights]
    if sum(sizes) > _MAX_SUMS:
        found = stats.permutation_test(
            (np.array(weights, dtype=float),),
            np.mean,
            permutation_type="samples",
            n_resamples=_RANDOM_FLIPS,
            rng=np.random.default_rng(0),
        )
        return float(found.pvalue)
    # ways[s]: probability that the weights flipped to the positive side add up to s.
    ways = np.ones(1)
    for size in sizes:
        ways = np.pad(ways, (0, size)) / 2 + np.pad(ways, (size, 0)) / 2
    sums = np.abs(2 * np.arange(ways.size) - sum(sizes))
    return min(1.0, float(ways[sums >= abs(int(sum(weights) * scale))].sum()))
