"""Results of a study so far: its ended sessions, read from its file."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, median
from typing import TYPE_CHECKING, TypeVar

from bbq_torchrl.people.study.database import reading
from bbq_torchrl.people.study.plan import Terms
from bbq_torchrl.people.study.records import (
    EXCHANGES,
    NOT_FORGOTTEN,
    SESSIONS,
    Session,
    StoredExchange,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

Value = TypeVar("Value")


@dataclass(frozen=True)
class Result(Session):
    """An ended session; its person is an anonymous name: ``P1``, ``P2``, ...

    Attributes:
        exchanges: the session's exchanges.
    """

    exchanges: tuple[StoredExchange, ...]

    @property
    def pauses(self) -> list[float]:
        """Seconds between each answer and the answer to the participant's next message."""
        times = [exchange.at for exchange in self.exchanges]
        return [later - earlier for earlier, later in pairwise(times)]

    @property
    def entropy(self) -> float | None:
        """Mean over turns of the entropy of the best action; ``None`` without a posterior."""
        return self.entropy_of_first(len(self.exchanges))

    def entropy_of_first(self, number: int) -> float | None:
        """Returns the mean entropy over the first exchanges; ``None`` without a posterior."""
        found = [item.beliefs["entropy"] for item in self.exchanges[:number] if item.beliefs]
        return fmean(found) if found else None


@dataclass(frozen=True)
class Results:
    """A study's results.

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
    sessions: tuple[Result, ...]

    @property
    def title(self) -> str:
        """The study's name, marked if its participants are simulated."""
        return f"{self.terms.name}{' (simulated users)' if self.simulated else ''}"

    def by_person(
        self, of: Callable[[Result], Value | None], agent: str | None = None
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
        found = {person: _flags(people[person]) for person in sorted(people, key=_number)}
        return {person: flags for person, flags in found.items() if flags}


def _number(person: str) -> int:
    return int(person.removeprefix("P"))


FAST_SECONDS = 2.0
"""A participant who mostly replies sooner has hardly read the answers."""


def _flags(sessions: Sequence[Result]) -> list[str]:
    pauses = [pause for session in sessions for pause in session.pauses]
    rated = [session.ratings for session in sessions if session.ratings]
    checks = {
        f"too fast: mostly under {FAST_SECONDS:g} s between answer and message": (
            len(pauses) > 2 and median(pauses) < FAST_SECONDS
        ),
        "always the same rating": (
            len(rated) > 1 and len({value for scales in rated for value in scales.values()}) == 1
        ),
        "one message a conversation": all(len(session.exchanges) < 2 for session in sessions),
    }
    return [flag for flag, holds in checks.items() if holds]


def read_results(data: Path) -> Results:
    """Returns the results in a study's file, even while it is being served.

    Args:
        data: the SQLite file.

    Raises:
        StoreError: it cannot be read.
    """
    with reading(data) as connection:
        terms, package, simulated = connection.execute(
            "SELECT terms, package, simulated FROM study"
        ).fetchone()
        people = connection.execute(f"SELECT id, token FROM person {NOT_FORGOTTEN}").fetchall()
        names = report_names(people)
        sessions = [
            Session.of(row) for row in connection.execute(f"{SESSIONS} ORDER BY session.id")
        ]

        def result(session: Session) -> Result:
            rows = connection.execute(EXCHANGES, (session.id,))
            exchanges = tuple(map(StoredExchange.of, rows))
            return Result(**{**vars(session), "person": names[session.person]}, exchanges=exchanges)

        return Results(
            terms=Terms.of(terms),
            package=package,
            simulated=bool(simulated),
            enrolled=len(people),
            open=sum(session.messages > 0 and not session.is_ended for session in sessions),
            sessions=tuple(result(session) for session in sessions if session.is_ended),
        )


def report_names(people: Sequence[tuple[int, str]]) -> dict[str, str]:
    """Returns the names in a report by participant number; they do not reveal who came when.

    Args:
        people: each participant's number and link hash, without forgotten participants.
    """
    by_chance = sorted(people, key=lambda person: hashlib.sha256(person[1].encode()).digest())
    return {str(person): f"P{number}" for number, (person, _) in enumerate(by_chance, start=1)}
