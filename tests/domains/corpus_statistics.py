"""Plain counts over a corpus, made without any of the library's machinery."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from bbq_torchrl.domains import Domain, Goal


def share(slot: str, holders: Sequence[Container[str]]) -> float:
    """The share of records, constraints or requests that have the slot."""
    return sum(slot in holder for holder in holders) / len(holders)


def matching(domain: Domain, goal: Goal) -> list[Mapping[str, str]]:
    """The records that meet all that the goal constrains."""
    wanted = {s: v.lower() for s, v in goal.constraints.items() if s not in domain.free_slots}
    return [
        record
        for record in domain.records
        if all(slot in record and record[slot].lower() == v for slot, v in wanted.items())
    ]


def goals_met(domain: Domain) -> int:
    """How many goals at least one record meets."""
    return sum(bool(matching(domain, goal)) for goal in domain.goals)


def goals_answerable(domain: Domain) -> int:
    """How many goals one record both meets and answers: the ceiling of success."""
    return sum(
        any(set(goal.requests) <= set(record) for record in matching(domain, goal))
        for goal in domain.goals
    )


# The public corpus, as the environment's description states it; ours is as sparse.
RECORDS = {
    "moviename": 0.97,
    "theater": 0.93,
    "date": 0.92,
    "starttime": 0.91,
    "city": 0.89,
    "state": 0.62,
    "zip": 0.33,
    "other": 0.32,
    "genre": 0.30,
    "distanceconstraints": 0.24,
    "critic_rating": 0.16,
    "video_format": 0.15,
    "theater_chain": 0.10,
    "mpaa_rating": 0.07,
}
DISTINCT = {"moviename": 59, "city": 87, "starttime": 211, "theater": 227, "date": 50}
CONSTRAINTS = {
    "numberofpeople": 1.0,
    "moviename": 0.66,
    "date": 0.63,
    "city": 0.62,
    "starttime": 0.47,
    "theater": 0.36,
    "state": 0.17,
    "genre": 0.11,
}
REQUESTS = {"theater": 0.64, "starttime": 0.53, "date": 0.37, "moviename": 0.34}
