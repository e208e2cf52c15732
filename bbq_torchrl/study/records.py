"""What is stored of a study, as objects: people, their sessions and what was said in them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bbq_torchrl.study.talk import Frame

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["EXCHANGES", "SCALES", "SESSIONS", "Person", "Session", "StoredExchange"]

SCALES = ("overall", "naturalness", "coherence", "completion")
"""What people rate from 1 to 5; the first is the paper's one figure."""


@dataclass(frozen=True)
class StoredExchange:
    """A person's text and the agent's answer.

    Attributes:
        number: from 1.
        at: when it was stored, seconds since 1970.
        text: the person's.
        answer: the agent's.
        heard: what was understood.
        said: the agent's act.
        beliefs: the agent's, as plain data.
        state: the talker's.
    """

    number: int
    at: float
    text: str
    answer: str
    heard: Frame
    said: Frame
    beliefs: Mapping[str, Any] | None
    state: str

    @classmethod
    def of(cls, row: tuple[Any, ...]) -> StoredExchange:
        """Returns the exchange in a row of :data:`EXCHANGES`."""
        number, at, text, answer, heard, said, beliefs, state = row
        frames = Frame.of(json.loads(heard)), Frame.of(json.loads(said))
        content = None if beliefs is None else json.loads(beliefs)
        return cls(number, at, text, answer, *frames, content, state)


@dataclass(frozen=True)
class Session:
    """A conversation that a person has, or is to have.

    Attributes:
        id: in the file.
        position: among the person's sessions, from 1.
        agent: its name.
        goal: number of the goal in the domain, from 1.
        is_ended: nothing more is said.
        is_rated: the person has rated it.
    """

    id: int
    position: int
    agent: str
    goal: int
    is_ended: bool
    is_rated: bool

    @classmethod
    def of(cls, row: tuple[Any, ...]) -> Session:
        """Returns the session in a row of :data:`SESSIONS`."""
        return cls(*row[:4], *map(bool, row[4:]))


@dataclass(frozen=True)
class Person:
    """Somebody who takes part.

    Attributes:
        sessions: first to last.
    """

    sessions: tuple[Session, ...]

    @property
    def current(self) -> Session | None:
        """The first session that is not rated; ``None`` after the last."""
        return next((session for session in self.sessions if not session.is_rated), None)


EXCHANGES = """
    SELECT number, at, text, answer, heard, said, beliefs, state FROM exchange
    WHERE session = ? ORDER BY number
"""
"""Selects of a session what :meth:`StoredExchange.of` takes, first to last."""

SESSIONS = """
    SELECT session.id, position, agent, goal, ended IS NOT NULL, rating.session IS NOT NULL
    FROM session LEFT JOIN rating ON rating.session = session.id
"""
"""Selects what :meth:`Session.of` takes."""
