"""Two agents of a study compared: the declared test, and the usual ones next to it."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.people.study.records import HIGHEST, LOWEST
from bbq_torchrl.people.study.statistics import Interval, mann_whitney, mean, sign_flip, two_by_two
from bbq_torchrl.utils.statistics import holm

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from bbq_torchrl.people.study.results import Results


class Difference(NamedTuple):
    """People's differences between two agents in success, or in the overall rating.

    Attributes:
        people: how many have sessions with both.
        mean: over these, with its interval.
        p: of the sign-flip test.
        holm: the same, adjusted for all declared pairs.
    """

    people: int
    mean: Interval
    p: float
    holm: float


class Comparison(NamedTuple):
    """A declared pair.

    Attributes:
        better: the agent declared first.
        worse: the other.
        success: the difference in success.
        rating: the difference in the overall rating.
        fisher: Fisher's exact p over all sessions of the two.
        boschloo: Boschloo's exact p over the same.
        mann_whitney: p over all ratings of the two.
    """

    better: str
    worse: str
    success: Difference
    rating: Difference
    fisher: float
    boschloo: float
    mann_whitney: float


def compare_pairs(results: Results, without: Collection[str] = ()) -> list[Comparison]:
    """Returns the comparison of every declared pair.

    Args:
        results: the study's.
        without: people who are left out.
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
        tests = (*two_by_two(*won), mann_whitney(*rated))
        compared.append(Comparison(better, worse, in_success, in_rating, *tests))
    return compared


def _differences(
    results: Results, of: Callable[[str], Mapping[str, Sequence[int]]], most: int
) -> list[Difference]:
    """Returns of each pair people's means with one agent minus those with the other.

    These lie between ``-most`` and ``most``.
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
            len(values), mean([[float(value)] for value in values], (-most, most)), own, adjusted
        )
        for values, own, adjusted in zip(pairs, p, holm(p), strict=True)
    ]
