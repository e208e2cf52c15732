"""A study's data: pseudonymous exports, backups, and forgetting a participant."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from bbq_torchrl.people.study.database import (
    IS_FINISHED,
    NOT_FORGOTTEN,
    SCALES,
    StoreError,
    opened,
)
from bbq_torchrl.people.study.outcomes import Outcome, Outcomes, report_names
from bbq_torchrl.people.study.storage import hashed
from bbq_torchrl.utils.files import csv_text, write_text

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


def export(folder: Path, outcomes: Outcomes) -> None:
    """Writes ``sessions.csv``, ``exchanges.csv`` and ``sessions.jsonl``.

    Participants are ``P1``, ``P2``, ...; times are seconds since a session's first answer. In CSV
    files an apostrophe precedes a text that a spreadsheet would run; JSON lines have it unchanged.
    CSV files begin with a byte order mark: without it Excel takes UTF-8 for another encoding.

    Args:
        folder: the output folder.
        outcomes: the study's outcomes.
    """
    sessions, exchanges, lines = [], [], []
    simulated = {"simulated": int(outcomes.simulated)}
    for item in outcomes.sessions:
        spoken = list(_exchanges(item))
        content = {**asdict(item), "exchanges": spoken, "simulated": outcomes.simulated}
        for key in ("rating_nonce", "messages"):
            del content[key]
        lines.append(json.dumps(content, ensure_ascii=False) + "\n")
        about = ("person", "position", "agent", "goal", "ended_by")
        sessions.append(
            {
                **{"session": item.id, **{key: content[key] for key in about}},
                **{"success": int(item.success), "reasons": "; ".join(item.reasons)},
                **{scale: item.ratings[scale] if item.ratings else "" for scale in SCALES},
                "own_verdict": "" if item.verdict is None else int(item.verdict),
                **{"exchanges": item.messages, "entropy": item.entropy(), **simulated},
            }
        )
        texts = ("number", "seconds", "text", "answer")
        for said, stored in zip(spoken, item.exchanges, strict=True):
            exchanges.append(
                {
                    **{"session": item.id, **{key: said[key] for key in texts}},
                    "understood": without_names(str(stored.understood)),
                    "answered": without_names(str(stored.answered)),
                    "entropy": stored.beliefs["entropy"] if stored.beliefs else "",
                    **simulated,
                }
            )
    _write_csv(folder / "sessions.csv", sessions)
    _write_csv(folder / "exchanges.csv", exchanges)
    write_text(folder / "sessions.jsonl", "".join(lines))


def _exchanges(item: Outcome) -> Iterable[dict[str, Any]]:
    """Yields a session's exchanges as plain data, without names and the talker's state."""
    for stored in item.exchanges:
        content = {"seconds": round(stored.at - item.exchanges[0].at, 3), **asdict(stored)}
        for key in ("at", "nonce", "state"):  # the talker's state may repeat texts
            del content[key]
        yield _anonymous(content)


def _anonymous(content: Any) -> Any:
    """Returns plain data with :func:`without_names` applied to every text."""
    if isinstance(content, str):
        return without_names(content)
    if isinstance(content, dict):
        return {key: _anonymous(value) for key, value in content.items()}
    return [_anonymous(item) for item in content] if isinstance(content, list | tuple) else content


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


def _write_csv(file: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes rows of the same keys, which head the columns."""
    cells = ({name: defused(cell) for name, cell in row.items()} for row in rows)
    write_text(file, f"\ufeff{csv_text(cells, rows[0]) if rows else ''}")


_PARTICIPANTS = f"""
    SELECT person.id, token, ids AS "ids [json]", enrolled, active,
           (SELECT COUNT(rated) FROM session WHERE session.person = person.id), {IS_FINISHED}
    FROM person {NOT_FORGOTTEN} ORDER BY person.id
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
    with opened(data) as connection:
        people = connection.execute(_PARTICIPANTS).fetchall()
    names = report_names([(number, token) for number, token, *_ in people])
    parameters = dict.fromkeys(key for _, _, ids, *_ in people for key in ids)
    rows = [
        {
            "person": number,
            "name_in_report": names[str(number)],
            **{key: ids.get(key, "") for key in parameters},
            "joined": _utc(enrolled),
            "last_active": _utc(active),
            "rated": rated,
            "finished": finished,
        }
        for number, _, ids, enrolled, active, rated, finished in people
    ]
    _write_csv(file, rows)
    return len(rows)


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat(timespec="seconds")


def backup(data: Path, target: Path) -> None:
    """Copies a snapshot of a study's file. The copy is one file.

    Args:
        data: the SQLite file.
        target: the copy, which must not exist.

    Raises:
        StoreError: the file cannot be read.
        OSError: the copy cannot be created there.
    """
    with opened(data, "rw") as connection:
        target.touch(exist_ok=False)  # else SQLite would write into an empty file
        connection.execute("VACUUM INTO ?", (str(target),))


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
    """
    token = hashed(participant.rstrip("/").rpartition("/")[2])
    whose = "SELECT id FROM person WHERE token = ? OR CAST(id AS TEXT) = ?"
    with opened(data, "rw") as connection:
        connection.execute("BEGIN IMMEDIATE")
        found = connection.execute(whose, (token, participant)).fetchone()
        if found is None:
            raise StoreError(str(data), ["nobody has that number on your page, or that link"])
        for statement in (
            "DELETE FROM exchange WHERE session IN (SELECT id FROM session WHERE person = ?)",
            "DELETE FROM session WHERE person = ?",
            "UPDATE person SET token = 'forgotten ' || id, place = -1, enrolled = 0, active = 0, "
            "ids = '{}' WHERE id = ?",
        ):
            connection.execute(statement, found)
        connection.execute("COMMIT")
        # SQLite leaves deleted texts in free pages and in the write-ahead log.
        connection.execute("VACUUM")
        is_busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    if is_busy:
        text = "the person is forgotten, but texts are still in its log, which a report reads now"
        raise StoreError(str(data), [f"{text}: run the command again"])
    return int(found[0])
