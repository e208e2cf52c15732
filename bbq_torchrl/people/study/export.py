"""A study's data: pseudonymous exports, backups, and forgetting a participant."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import sqlite3
from contextlib import closing
from dataclasses import asdict
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any

from bbq_torchrl.people.study.database import (
    PRIVATE,
    SIDE_FILES,
    StoreError,
    as_store_errors,
    changing,
    make_private,
    reading,
)
from bbq_torchrl.people.study.plan import StudyError, Terms
from bbq_torchrl.people.study.records import (
    IS_FINISHED,
    NOT_FORGOTTEN,
    SCALES,
    act_content,
    act_text,
)
from bbq_torchrl.people.study.results import report_names
from bbq_torchrl.people.study.store import hashed
from bbq_torchrl.utils.files import write_text
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from bbq_torchrl.people.study.results import Results


_FORMULA = ("=", "+", "-", "@")
_REPLACED = (
    (re.compile(r"[\w.+-]+@[\w-]+\.[\w.-]+"), "[address]"),
    (re.compile(r"(?<!\d)\+?\d(?:[ ()./-]{0,2}\d){6,18}(?!\d)"), "[number]"),
    (
        re.compile(
            r"\b(my name(?:'s| is)|call me|(?:it is|it's) under|the name is|under the name(?: of)?)"
            r"((?: (?!and\b|but\b|please\b|for\b)[^\W\d_][\w'’-]*){1,3})",
            re.IGNORECASE,
        ),
        r"\1 [name]",
    ),
)


def export(folder: Path, results: Results) -> None:
    """Writes ``sessions.csv``, ``exchanges.csv`` and ``sessions.jsonl``.

    Participants are ``P1``, ``P2``, ...; times are seconds since a session's first answer. In CSV
    files an apostrophe precedes a text that a spreadsheet would run; JSON lines have it unchanged.
    CSV files begin with a byte order mark: without it Excel takes UTF-8 for another encoding.

    Args:
        folder: the output folder.
        results: the study's results.
    """
    head = ("session", "person", "position", "agent", "goal", "ended_by", "success", "reasons")
    rows = [
        (
            *(item.id, item.person, item.position, item.agent, item.goal, item.ended_by),
            *(int(item.success), "; ".join(item.reasons)),
            *(item.ratings[name] if item.ratings else "" for name in SCALES),
            "" if item.verdict is None else int(item.verdict),
            len(item.exchanges),
            "" if item.entropy is None else item.entropy,
            int(results.simulated),
        )
        for item in results.sessions
    ]
    columns = (*head, *SCALES, "own_verdict", "exchanges", "entropy", "simulated")
    write_text(folder / "sessions.csv", _csv(columns, rows), PRIVATE)
    said = ("session", "number", "seconds", "text", "answer", "heard", "said")
    columns_said = (*said, "entropy", "simulated")
    write_text(folder / "exchanges.csv", _csv(columns_said, _exchange_rows(results)), PRIVATE)
    write_text(folder / "sessions.jsonl", "".join(_lines(results)), PRIVATE)


_PARTICIPANTS = f"""
    SELECT person.id, token, ids, enrolled, active,
           (SELECT COUNT(*) FROM session JOIN rating ON rating.session = session.id
            WHERE session.person = person.id),
           {IS_FINISHED}
    FROM person LEFT JOIN recruited ON recruited.person = person.id
    {NOT_FORGOTTEN} ORDER BY person.id
"""


def export_participants(file: Path, data: Path) -> int:
    """Writes participants' ids from the join link and their progress, for payment.

    The file identifies the participants in a report, so it is separate from the report.

    Args:
        file: the CSV file.
        data: the study's SQLite file.

    Returns:
        The number of participants in it.

    Raises:
        StoreError: the study's file cannot be read.
    """
    with reading(data) as connection:
        [terms] = connection.execute("SELECT terms FROM study").fetchone()
        people = connection.execute(_PARTICIPANTS).fetchall()
    names = report_names([(number, token) for number, token, *_ in people])
    ids = [json.loads(stored or "{}") for _, _, stored, *_ in people]
    # The study file may have named other parameters before.
    parameters = dict.fromkeys(
        [*Terms.of(terms).join_parameters, *(key for one in ids for key in one)]
    )
    rows = [
        (
            *(number, names[str(number)]),
            *(found.get(name, "") for name in parameters),
            *(_utc(enrolled), _utc(active), rated, finished),
        )
        for found, (number, _, _, enrolled, active, rated, finished) in zip(
            ids, people, strict=True
        )
    ]
    head = ("person", "name_in_report", *parameters, "joined", "last_active", "rated", "finished")
    write_text(file, _csv(head, rows), PRIVATE)
    return len(rows)


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="seconds")


def without_names(text: str) -> str:
    """Returns a text with addresses, long numbers and names introduced as such replaced.

    Other personal information stays: read texts before you publish them.

    Examples:
        >>> without_names("My name is Ann Lee, ann@example.org or 555-123-4567")
        'My name is [name], [address] or [number]'
    """
    for pattern, replacement in _REPLACED:
        text = pattern.sub(replacement, text)
    return text


def defused(cell: Any) -> Any:
    """Returns a cell that no spreadsheet reads as a formula.

    Examples:
        >>> defused("=cmd()"), defused(-3)
        ("'=cmd()", -3)
    """
    is_formula = isinstance(cell, str) and cell.lstrip().startswith(_FORMULA)
    return f"'{cell}" if is_formula else cell


def _csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    text.write("\ufeff")
    writer = csv.writer(text)
    writer.writerow(head)
    writer.writerows([defused(cell) for cell in row] for row in rows)
    return text.getvalue()


def _exchange_rows(results: Results) -> Iterable[Sequence[Any]]:
    for item in results.sessions:
        for said in item.exchanges:
            yield (
                *(item.id, said.number, round(said.at - item.exchanges[0].at, 3)),
                *(without_names(said.text), without_names(said.answer)),
                *(without_names(act_text(said.heard)), without_names(act_text(said.said))),
                said.beliefs["entropy"] if said.beliefs else "",
                int(results.simulated),
            )


def _lines(results: Results) -> Iterable[str]:
    for item in results.sessions:
        content = asdict(item)
        for said, stored in zip(content["exchanges"], item.exchanges, strict=True):
            said["seconds"] = round(said.pop("at") - item.exchanges[0].at, 3)
            said["text"] = without_names(stored.text)
            said["answer"] = without_names(stored.answer)
            said["heard"] = act_content(stored.heard, said.pop("confidence"))
            said["said"] = act_content(stored.said)
            for frame in (said["heard"], said["said"]):
                frame["informs"] = {
                    slot: without_names(value) for slot, value in frame["informs"].items()
                }
            del said["state"], said["nonce"]  # the talker's state may repeat texts
        del content["messages"]
        line = {**content, "simulated": results.simulated}
        yield json.dumps(line, ensure_ascii=False) + "\n"


_NUMBER = re.compile("[0-9]{1,18}")
_LINK = re.compile(r".*/p/([\w-]+)/?", re.ASCII)


def backup(data: Path, target: Path) -> None:
    """Copies a snapshot of a study's file. The copy is one file, private to its owner.

    Args:
        data: the SQLite file.
        target: the copy, which must not exist.

    Raises:
        StoreError: the file cannot be read, or the copy cannot be created there.
    """
    kept = [data, *(data.with_name(data.name + end) for end in (*SIDE_FILES, ".lock"))]
    if target.resolve() in [path.resolve() for path in kept]:
        raise StoreError(target, "it is of the living study: name another file for the copy")
    if target.exists() or target.is_symlink():
        raise StoreError(target, "it exists already: name a file that does not exist")
    if not target.parent.is_dir():
        raise StoreError(target, "its folder does not exist")
    temporary = target.with_name(f".{target.name}.new")
    temporary.unlink(missing_ok=True)  # left by a killed process
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
    """Deletes a participant's conversations, ratings, times, ids and link, and frees their place.

    Only the number is kept, so that nobody else gets it. Forgetting a participant again is
    allowed.

    Args:
        data: the SQLite file.
        participant: the number on the researcher's page, or the participant's link.

    Returns:
        The participant's number.

    Raises:
        StoreError: the file cannot be used, or has no such participant.
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
