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
