"""The SQLite file of a study: opened by one server, never half written."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from filelock import FileLock, Timeout

from bbq_torchrl.people.study.plan import StudyError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_SCHEMAS = (
    """
CREATE TABLE study (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    terms TEXT NOT NULL,
    package TEXT NOT NULL,
    secret TEXT NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    created REAL NOT NULL
) STRICT;
CREATE TABLE agent (
    name TEXT PRIMARY KEY,
    fingerprint TEXT NOT NULL
) STRICT;
CREATE TABLE person (
    id INTEGER PRIMARY KEY,
    token TEXT NOT NULL UNIQUE,
    place INTEGER NOT NULL,
    enrolled REAL NOT NULL,
    active REAL NOT NULL
) STRICT;
CREATE INDEX person_by_place ON person (place);
CREATE TABLE session (
    id INTEGER PRIMARY KEY,
    person INTEGER NOT NULL REFERENCES person,
    position INTEGER NOT NULL,
    agent TEXT NOT NULL REFERENCES agent,
    goal INTEGER NOT NULL,
    ended REAL,
    ended_by TEXT CHECK (ended_by IN ('agent', 'person', 'turns')),
    success INTEGER CHECK (success IN (0, 1)),
    reasons TEXT,
    UNIQUE (person, position)
) STRICT;
CREATE TABLE exchange (
    session INTEGER NOT NULL REFERENCES session,
    number INTEGER NOT NULL,
    nonce TEXT NOT NULL,
    at REAL NOT NULL,
    text TEXT NOT NULL,
    answer TEXT NOT NULL,
    heard TEXT NOT NULL,
    said TEXT NOT NULL,
    beliefs TEXT,
    state TEXT NOT NULL,
    PRIMARY KEY (session, number),
    UNIQUE (session, nonce)
) STRICT;
CREATE TABLE rating (
    session INTEGER PRIMARY KEY REFERENCES session,
    nonce TEXT NOT NULL,
    at REAL NOT NULL,
    overall INTEGER NOT NULL CHECK (overall BETWEEN 1 AND 5),
    naturalness INTEGER NOT NULL CHECK (naturalness BETWEEN 1 AND 5),
    coherence INTEGER NOT NULL CHECK (coherence BETWEEN 1 AND 5),
    completion INTEGER NOT NULL CHECK (completion BETWEEN 1 AND 5),
    verdict INTEGER NOT NULL CHECK (verdict IN (0, 1))
) STRICT;
""",
    """
CREATE TABLE recruited (
    person INTEGER PRIMARY KEY REFERENCES person,
    participant TEXT NOT NULL UNIQUE,
    ids TEXT NOT NULL
) STRICT;
""",
)
"""The additions of each version to those before."""
_VERSION = len(_SCHEMAS)
_MISSING = "CREATE TEMP TABLE recruited (person INTEGER, participant TEXT, ids TEXT)"
"""A stand-in for the table that version 1 lacks, for reading and for deleting participants."""

SIDE_FILES = ("-wal", "-shm", "-journal")
"""The suffixes of the files that SQLite keeps next to a study's file."""

PRIVATE = 0o600
"""Mode of all files of a study: they have participants' texts and the secret behind all links."""

BUSY_SECONDS = 5.0
"""The time that a change waits for others."""

_SQLITE = (3, 37, 0)  # the first with STRICT tables


class StoreError(StudyError):
    """Study data that cannot be read or written.

    Args:
        path: the data file.
        faults: one or more sentences.
    """

    def __init__(self, path: Path, *faults: str) -> None:
        super().__init__(str(path), faults)


@contextmanager
def writing(path: Path) -> Iterator[sqlite3.Connection]:
    """Opens a study's file for one server, and creates or extends it if needed.

    Raises:
        StoreError: another server uses the file, or it is newer, damaged, read-only or foreign.
    """
    if sqlite3.sqlite_version_info < _SQLITE:
        raise StoreError(path, f"it needs SQLite 3.37 or newer, this is {sqlite3.sqlite_version}")
    if not path.parent.is_dir():
        raise StoreError(path, "its folder does not exist")
    try:
        lock = FileLock(path.with_name(f"{path.name}.lock"), mode=PRIVATE).acquire(timeout=0)
    except Timeout as error:
        text = "another server is at work on it: end that one, or wait"
        raise StoreError(path, text) from error
    except OSError as error:
        raise StoreError(path, f"it cannot be used: {error.strerror}") from error
    with lock, as_store_errors(path), closing(_private(path)) as connection:
        version = _check(path, connection)
        for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
            connection.execute(f"PRAGMA {pragma}")
        # Written even if unchanged, to detect a read-only file system now.
        script = "".join(_SCHEMAS[version:])
        connection.executescript(
            f"BEGIN IMMEDIATE; {script} PRAGMA user_version = {_VERSION}; COMMIT;"
        )
        yield connection


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """Opens a study's file for reading, even while a server is using it.

    Raises:
        StoreError: there is no such file, or it is newer or damaged.
    """
    with _existing(path, "ro") as connection:
        connection.execute("BEGIN")  # one snapshot for all queries
        yield connection


@contextmanager
def changing(path: Path) -> Iterator[sqlite3.Connection]:
    """Opens a study's file for a change, even while a server is using it.

    Raises:
        StoreError: as for :func:`reading`, or it cannot be written.
    """
    with _existing(path, "rw") as connection:
        connection.execute("PRAGMA foreign_keys = ON")
        yield connection


@contextmanager
def _existing(path: Path, mode: str) -> Iterator[sqlite3.Connection]:
    if not path.is_file():
        raise StoreError(path, "there is no such file: the study has not been served yet")
    address = f"{path.absolute().as_uri()}?mode={mode}"
    with (
        as_store_errors(path),
        closing(
            sqlite3.connect(address, timeout=BUSY_SECONDS, uri=True, isolation_level=None)
        ) as connection,
    ):
        version = _check(path, connection)
        if not version:
            raise StoreError(path, "it is empty: the study has not been served yet")
        if version < _VERSION:  # only a server upgrades it: an older one may be using it
            connection.execute(_MISSING)
        yield connection


def _private(path: Path) -> sqlite3.Connection:
    make_private(path)
    return sqlite3.connect(path, isolation_level=None, check_same_thread=False)


def make_private(path: Path) -> None:
    """Makes a file private to its owner: a new one, or an existing one with its side files.

    Raises:
        StoreError: it cannot be created there, or its mode cannot be changed.
    """
    try:
        if not path.exists():
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, PRIVATE))
        for file in (path, *(path.with_name(path.name + end) for end in SIDE_FILES)):
            if file.exists() and file.stat().st_mode & 0o077:
                file.chmod(PRIVATE)
    except OSError as error:
        text = f"it cannot be made a file that its owner alone can read: {error.strerror}"
        raise StoreError(path, text) from error


def _check(path: Path, connection: sqlite3.Connection) -> int:
    """Refuses a newer, damaged or foreign file. Returns the file's version."""
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version > _VERSION:
        raise StoreError(
            path,
            f"it is of version {version}, made by a newer bbq-torchrl; "
            f"this one reads versions up to {_VERSION}",
        )
    found = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if found != "ok":
        raise StoreError(path, f"it is damaged: {found}")
    tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    if version == 0 and tables:
        raise StoreError(path, "it is a database, but not one of a study")
    return version


@contextmanager
def as_store_errors(path: Path) -> Iterator[None]:
    """Turns errors of SQLite into :class:`StoreError`."""
    try:
        yield
    except sqlite3.Error as error:
        text = str(error)
        known = {
            "full": "the disk is full: nothing of the last step was stored",
            "readonly": "it is read-only: a study needs a file that it can write",
            "not a database": "it is damaged, or no SQLite file",
            "malformed": "it is damaged",
            "unable to open": "it cannot be opened or made there",
        }
        said = next((says for key, says in known.items() if key in text), "SQLite says")
        raise StoreError(path, f"{said} ({text})") from error
