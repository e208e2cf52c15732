"""Two agents of a study compared: the declared test, and the usual ones beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

from bbq_torchrl.statistics import holm
from bbq_torchrl.study.statistics import Interval, mann_whitney, mean, sign_flip, two_by_two

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from bbq_torchrl.study.results import Results

__all__ = ["Comparison", "compare_pairs"]


@dataclass(frozen=True)
class Comparison:
    """A declared pair.

    Attributes:
        better: the agent declared first.
        worse: the other.
        people: how many have an ended session with both.
        success: mean over these of the difference in success, with its t interval.
        p: of the sign-flip test of that difference.
        holm: the same, adjusted for all declared pairs.
        fisher: Fisher's exact p over all sessions of the two.
        boschloo: Boschloo's exact p over the same.
        rating: mean over people of the difference in the overall rating.
        rating_p: of its sign-flip test.
        rating_holm: the same, adjusted.
        mann_whitney: p over all ratings of the two.
    """

    better: str
    worse: str
    people: int
    success: Interval
    p: float
    holm: float
    fisher: float
    boschloo: float
    rating: Interval
    rating_p: float
    rating_holm: float
    mann_whitney: float


def compare_pairs(results: Results, without: Collection[str] = ()) -> list[Comparison]:
    """Returns the comparison of every declared pair.

    Args:
        results: the study's.
        without: people who are left out.
    """
    kept = [session for session in results.sessions if session.person not in without]
    results = replace(results, sessions=tuple(kept))
    found = [_compare(results, *pair) for pair in results.terms.pairs]
    primary = holm([comparison.p for comparison in found])
    ratings = holm([comparison.rating_p for comparison in found])
    return [
        replace(comparison, holm=adjusted, rating_holm=rated)
        for comparison, adjusted, rated in zip(found, primary, ratings, strict=True)
    ]


def _compare(results: Results, better: str, worse: str) -> Comparison:
    won = [results.successes(agent) for agent in (better, worse)]
    rated = [results.ratings(agent) for agent in (better, worse)]
    success, rating = _differences(*won), _differences(*rated)
    fisher, boschloo = two_by_two(*map(_all, won))
    p, rating_p = sign_flip(success), sign_flip(rating)
    return Comparison(
        better=better,
        worse=worse,
        people=len(success),
        success=mean([[float(value)] for value in success]),
        p=p,
        holm=p,
        fisher=fisher,
        boschloo=boschloo,
        rating=mean([[float(value)] for value in rating]),
        rating_p=rating_p,
        rating_holm=rating_p,
        mann_whitney=mann_whitney(*map(_all, rated)),
    )


def _all(by_person: Mapping[str, Sequence[int]]) -> list[int]:
    return [value for values in by_person.values() for value in values]


def _differences(
    one: Mapping[str, Sequence[int]], other: Mapping[str, Sequence[int]]
) -> list[Fraction]:
    """Returns each person's mean with one agent minus that with the other, of who has both."""
    first, second = (
        {person: Fraction(sum(v), len(v)) for person, v in side.items() if v}
        for side in (one, other)
    )
    return [first[person] - second[person] for person in sorted(first.keys() & second.keys())]
