"""Copies a study's file, and deletes from it what a person said; also while it is being served."""

from __future__ import annotations

import os
import re
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

from bbq_torchrl.people.study.database import (
    SIDE_FILES,
    StoreError,
    as_store_errors,
    changing,
    make_private,
    reading,
)
from bbq_torchrl.people.study.plan import StudyError
from bbq_torchrl.people.study.store import hashed
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from pathlib import Path

_NUMBER = re.compile("[0-9]{1,18}")
_LINK = re.compile(r".*/p/([\w-]+)/?", re.ASCII)


def backup(data: Path, target: Path) -> None:
    """Copies a study's file as it is at one moment. The copy is one file, for its owner alone.

    Args:
        data: the SQLite file.
        target: the copy, which must not exist.

    Raises:
        StoreError: the file cannot be read, or the copy cannot be made there.
    """
    kept = [data, *(data.with_name(data.name + end) for end in (*SIDE_FILES, ".lock"))]
    if target.resolve() in [path.resolve() for path in kept]:
        raise StoreError(target, "it is of the living study: name another file for the copy")
    if target.exists() or target.is_symlink():
        raise StoreError(target, "it exists already: name a file that does not exist")
    if not target.parent.is_dir():
        raise StoreError(target, "its folder does not exist")
    temporary = target.with_name(f".{target.name}.new")
    temporary.unlink(missing_ok=True)  # what a killed process left
    try:
        make_private(temporary)
        with (
            reading(data) as connection,
            as_store_errors(target),
            closing(sqlite3.connect(temporary)) as copy,
        ):
            connection.backup(copy)
            copy.execute("PRAGMA journal_mode = DELETE")  # one file, without side files
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def forget(data: Path, participant: str) -> int:
    """Deletes all of a person: conversations, ratings, times, ids and link; their place is free.

    Only their number is kept, so that nobody else gets it. Who is forgotten already may be
    forgotten again.

    Args:
        data: the SQLite file.
        participant: the number on the researcher's page, or the person's link.

    Returns:
        The person's number.

    Raises:
        StoreError: the file cannot be used, or nobody is that.
        StudyError: ``participant`` is neither number nor link.
    """
    link = _LINK.fullmatch(participant)
    if link is None and not _NUMBER.fullmatch(participant):
        text = f"it must be a person's number on your page or their link, got {shown(participant)}"
        raise StudyError("participant", [text])
    column, value = ("token", hashed(link[1])) if link else ("id", int(participant))
    with changing(data) as connection:
        connection.execute("BEGIN IMMEDIATE")
        found = connection.execute(f"SELECT id FROM person WHERE {column} = ?", (value,)).fetchone()
        if found is None:
            raise StoreError(data, f"there is nobody of the {'link' if link else 'number'} given")
        sessions = "(SELECT id FROM session WHERE person = ?)"
        for statement in (
            f"DELETE FROM rating WHERE session IN {sessions}",
            f"DELETE FROM exchange WHERE session IN {sessions}",
            "DELETE FROM session WHERE person = ?",
            "DELETE FROM recruited WHERE person = ?",
            "UPDATE person SET token = 'forgotten ' || id, place = -1, enrolled = 0, active = 0 "
            "WHERE id = ?",
        ):
            connection.execute(statement, found)
        connection.execute("COMMIT")
        # SQLite leaves deleted texts in free pages and in the write-ahead log.
        connection.execute("VACUUM")
        is_busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    if is_busy:
        text = "the person is forgotten, but texts are still in its log, which a report reads now"
        raise StoreError(data, f"{text}: run the command again")
    return int(found[0])
