"""The SQLite file of a study: opened by one server, never half written; and its records."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.study.plan import StudyError

SCALES = ("overall", "naturalness", "coherence", "completion")
"""The scales that participants rate from 1 to 5; the first is the paper's only one."""

LOWEST, HIGHEST = 1, 5
"""The lowest and the highest rating."""

_VERSION = 4
_SCHEMA = """
CREATE TABLE study (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    terms TEXT NOT NULL,
    fingerprints TEXT NOT NULL,
    package TEXT NOT NULL,
    secret TEXT NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    created REAL NOT NULL
) STRICT;
CREATE TABLE person (
    id INTEGER PRIMARY KEY,
    token TEXT NOT NULL UNIQUE,
    place INTEGER NOT NULL,
    enrolled REAL NOT NULL,
    active REAL NOT NULL,
    ids TEXT NOT NULL
) STRICT;
CREATE INDEX person_by_place ON person (place);
CREATE TABLE session (
    id INTEGER PRIMARY KEY,
    person INTEGER NOT NULL REFERENCES person,
    position INTEGER NOT NULL,
    agent TEXT NOT NULL,
    goal INTEGER NOT NULL,
    ended REAL,
    ended_by TEXT CHECK (ended_by IN ('agent', 'person', 'turns')),
    reasons TEXT,
    rated REAL,
    rating_nonce TEXT,
    ratings TEXT,
    verdict INTEGER CHECK (verdict IN (0, 1)),
    UNIQUE (person, position)
) STRICT;
CREATE TABLE exchange (
    session INTEGER NOT NULL REFERENCES session,
    number INTEGER NOT NULL,
    nonce TEXT NOT NULL,
    at REAL NOT NULL,
    text TEXT NOT NULL,
    answer TEXT NOT NULL,
    understood TEXT NOT NULL,
    answered TEXT NOT NULL,
    confidence REAL,
    beliefs TEXT,
    state TEXT NOT NULL,
    PRIMARY KEY (session, number),
    UNIQUE (session, nonce)
) STRICT;
"""

BUSY_SECONDS = 5.0
"""The time that a change waits for others."""


class StoreError(StudyError):
    """Study data that cannot be read or written."""


def _frame(text: bytes) -> Frame:
    content = json.loads(text)
    listed = {key: tuple(content[key]) for key in ("requests", "choices")}
    return Frame(**{**content, **listed})


sqlite3.register_converter("json", json.loads)
sqlite3.register_converter("truth", lambda number: number == b"1")
sqlite3.register_converter("frame", _frame)


@contextmanager
def serving(path: Path) -> Iterator[sqlite3.Connection]:
    """Opens a study's file for one server, and creates it if needed.

    Raises:
        StoreError: another server uses the file, or it is of another version, damaged, read-only or
            foreign, or restored beside an older log.
        OSError: its lock file cannot be made.
    """
    try:
        lock = FileLock(path.with_name(f"{path.name}.lock")).acquire(timeout=0)
    except Timeout as error:
        text = "another server is at work on it: end that one, or wait"
        raise StoreError(str(path), [text]) from error
    with lock, as_store_errors(path):
        _refuse_older_log(path)
        connection = sqlite3.connect(
            path,
            isolation_level=None,
            check_same_thread=False,
            detect_types=sqlite3.PARSE_COLNAMES,
        )
        with closing(connection):
            if connection.execute("SELECT COUNT(*) FROM sqlite_master").fetchone() == (0,):
                connection.executescript(
                    f"BEGIN IMMEDIATE; {_SCHEMA} PRAGMA user_version = {_VERSION}; COMMIT;"
                )
            _check(path, connection)
            for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
                connection.execute(f"PRAGMA {pragma}")
            yield connection


@contextmanager
def opened(path: Path, mode: str = "ro") -> Iterator[sqlite3.Connection]:
    """Opens a study's file, even while a server is using it.

    Args:
        path: the SQLite file.
        mode: ``ro`` for reading, as one snapshot for all queries, or ``rw`` for a change.

    Raises:
        StoreError: there is no such file, or it is of another version, damaged, foreign or
            restored beside an older log.
    """
    if not path.is_file():
        raise StoreError(str(path), ["there is no such file: the study has not been served yet"])
    address = f"{path.absolute().as_uri()}?mode={mode}"
    with as_store_errors(path):
        _refuse_older_log(path)
        connection = sqlite3.connect(
            address, BUSY_SECONDS, sqlite3.PARSE_COLNAMES, isolation_level=None, uri=True
        )
        with closing(connection):
            _check(path, connection)
            connection.execute("PRAGMA foreign_keys = ON")
            if mode == "ro":
                connection.execute("BEGIN")
            yield connection


def _refuse_older_log(path: Path) -> None:
    """Refuses a restored backup with the log of the file before it, which SQLite would read."""
    log = path.with_name(f"{path.name}-wal")
    if path.is_file() and log.is_file() and log.stat().st_size:
        with path.open("rb") as file:
            is_logged = file.read(20)[18:] == b"\x02\x02"  # never of a backup, always with a log
        if not is_logged:
            text = f"it is a backup beside the log of an older file: remove {log.name} and its -shm"
            raise StoreError(str(path), [text])


def _check(path: Path, connection: sqlite3.Connection) -> None:
    """Refuses a damaged file, a foreign one, and one of another version."""
    found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if found != "ok":
        raise StoreError(str(path), [f"it is damaged: {found}"])
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version != _VERSION:
        text = f"it is no study of version {_VERSION}, which this bbq-torchrl reads, but {version}"
        raise StoreError(str(path), [text])


@contextmanager
def as_store_errors(path: Path) -> Iterator[None]:
    """Turns errors of SQLite into :class:`StoreError`."""
    try:
        yield
    except sqlite3.Error as error:
        raise StoreError(str(path), [f"SQLite says: {error}"]) from error


@dataclass(frozen=True)
class Exchange:
    """A participant's text and the agent's answer.

    Attributes:
        number: the number in the session, from 1.
        nonce: the nonce of the participant's message.
        at: the time of storage, in seconds since 1970.
        text: the participant's text.
        answer: the agent's text.
        understood: the act understood.
        answered: the agent's act.
        confidence: the nlu's confidence, or ``None``.
        beliefs: the agent's beliefs, as plain data.
        state: the talker's state.
    """

    number: int
    nonce: str
    at: float
    text: str
    answer: str
    understood: Frame
    answered: Frame
    confidence: float | None
    beliefs: Mapping[str, Any] | None
    state: str


EXCHANGES = """
    SELECT number, nonce, at, text, answer, understood AS "u [frame]", answered AS "a [frame]",
           confidence, beliefs AS "b [json]", state
    FROM exchange WHERE session = ? ORDER BY number
"""
"""Selects the fields of :class:`Exchange` of a session, first to last."""


@dataclass(frozen=True)
class Session:
    """A participant's past, current or future conversation.

    Attributes:
        id: the id in the file.
        person: the participant's number.
        position: the position among the participant's sessions, from 1.
        agent: the agent's name.
        goal: number of the goal in the domain, from 1.
        ended_by: ``agent``, ``person`` or ``turns``; ``None`` before the end.
        reasons: the reasons for a failure.
        rating_nonce: the nonce of the rating; ``None`` before the participant rates.
        ratings: scale to 1 to 5; ``None`` before the participant rates.
        verdict: the participant's verdict; ``None`` before they rate.
        messages: the number of messages that the participant has sent.
    """

    id: int
    person: str
    position: int
    agent: str
    goal: int
    ended_by: str | None
    reasons: Sequence[str]
    rating_nonce: str | None
    ratings: Mapping[str, int] | None
    verdict: bool | None
    messages: int

    @property
    def is_ended(self) -> bool:
        """True once the conversation has ended."""
        return self.ended_by is not None

    @property
    def success(self) -> bool:
        """The judge's verdict; false before the end."""
        return self.is_ended and not self.reasons

    @property
    def is_rated(self) -> bool:
        """True once the participant has rated it."""
        return self.ratings is not None


SESSIONS = """
    SELECT id, CAST(person AS TEXT), position, agent, goal, ended_by,
           IFNULL(reasons, '[]') AS "reasons [json]", rating_nonce, ratings AS "ratings [json]",
           verdict AS "verdict [truth]",
           (SELECT COUNT(*) FROM exchange WHERE exchange.session = session.id)
    FROM session
"""
"""Selects the fields of :class:`Session`."""

NOT_FORGOTTEN = "WHERE place >= 0"
"""Condition on the table ``person``: the others are forgotten, and only their number is left."""

IS_FINISHED = """NOT EXISTS (
    SELECT 1 FROM session WHERE session.person = person.id AND rated IS NULL
)"""
"""Condition on the table ``person``: the participant has rated all their conversations."""

TAKEN = f"SELECT DISTINCT place FROM person WHERE active > ? OR {IS_FINISHED}"
"""Selects the places that nobody else gets, given the earliest time of activity."""


def current(sessions: Sequence[Session]) -> Session | None:
    """Returns the first session that is not rated; ``None`` after a participant's last."""
    return next((session for session in sessions if not session.is_rated), None)
