"""Reads and writes a domain as a folder of plain files.

=====================  ==========================================================================
``domain.yaml``        acts, slots, actions, special slots, policies, difficulty
``knowledge_base.csv`` a header of slots, then a record a line; an empty field is an absent value
``goals.jsonl``        ``{"constraints": {slot: value}, "requests": [slot]}`` a line
``values.json``        ``{slot: [value]}``: what an error can put in place of a slot's value
=====================  ==========================================================================
"""

from __future__ import annotations

import csv
import functools
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.domain import Domain, Goal
from bbq_torchrl.domains.specification import SPECIFICATION_FILE, read_specification
from bbq_torchrl.domains.values import DONT_CARE, RESERVED_TEXT, fold

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

__all__ = [
    "GOALS_FILE",
    "MOVIE_FOLDER",
    "RECORDS_FILE",
    "VALUES_FILE",
    "load_domain",
    "movie_domain",
    "save_data",
]

RECORDS_FILE = "knowledge_base.csv"
GOALS_FILE = "goals.jsonl"
VALUES_FILE = "values.json"

MOVIE_FOLDER = Path(__file__).parent / "movie"
"""The folder of the movie domain that comes with the package."""


def load_domain(path: str | Path) -> Domain:
    """Returns the domain that the folder ``path`` describes.

    Args:
        path: a folder with the four files named in this module's description.

    Raises:
        FileNotFoundError: if the folder or one of its files is missing.
        ValueError: if a file is damaged or the files do not fit together; the message names the
            file, the key and what is allowed.
    """
    folder = Path(path).expanduser()
    names = (SPECIFICATION_FILE, RECORDS_FILE, GOALS_FILE, VALUES_FILE)
    if missing := [name for name in names if not (folder / name).is_file()]:
        raise FileNotFoundError(f"the domain folder {folder} lacks {missing}")
    specification = read_specification(folder / SPECIFICATION_FILE)
    records = _read(folder / RECORDS_FILE, _parse_records)
    goals = _read(folder / GOALS_FILE, _parse_goals)
    values = _read(folder / VALUES_FILE, _parse_values)
    try:
        domain = Domain(**specification, records=records, goals=goals, error_values=values)
        _check_goal_values(domain)
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from error
    return domain


@functools.cache
def movie_domain() -> Domain:
    """Returns the movie-booking domain that comes with the package.

    Example:
        >>> domain = movie_domain()
        >>> len(domain.acts), len(domain.slots), len(domain.actions)
        (11, 29, 39)
        >>> str(domain.actions[domain.action_index("inform(ticket)")])
        'inform(ticket)'
    """
    return load_domain(MOVIE_FOLDER)


def save_data(
    folder: str | Path,
    slots: Sequence[str],
    records: Iterable[Mapping[str, str]],
    goals: Iterable[Goal],
    error_values: Mapping[str, Sequence[str]],
) -> None:
    """Writes a domain's records, goals and values into ``folder``, which must exist.

    ``domain.yaml``, which people write by hand, is left alone. Equal data give equal bytes.

    Args:
        folder: where the three files go.
        slots: the columns of the records, in order; slots that no record has may be left out.
        records: slot to value.
        goals: the users' goals.
        error_values: slot to values.
    """
    table = io.StringIO()
    writer = csv.DictWriter(table, fieldnames=slots, lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    lines = (
        json.dumps(
            {"constraints": dict(goal.constraints), "requests": list(goal.requests)},
            ensure_ascii=False,
        )
        for goal in goals
    )
    values = {slot: list(texts) for slot, texts in error_values.items()}
    for name, text in (
        (RECORDS_FILE, table.getvalue()),
        (GOALS_FILE, "".join(f"{line}\n" for line in lines)),
        (VALUES_FILE, json.dumps(values, ensure_ascii=False, indent=1) + "\n"),
    ):
        Path(folder, name).write_text(text, encoding="utf-8", newline="\n")


def _read(path: Path, parse: Any) -> Any:
    """Returns what ``parse`` makes of the file's text; errors name the file."""
    try:
        # newline="" keeps line ends inside quoted CSV fields as they are.
        with path.open(encoding="utf-8-sig", newline="") as file:
            return parse(file.read())
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} must be UTF-8 text: {error}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _parse_records(text: str) -> tuple[dict[str, str], ...]:
    if not text.strip():
        raise ValueError("the header, a line of slot names, is missing")
    if not text.endswith("\n"):
        raise ValueError("the last line must end with a line break; the file looks truncated")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    records = []
    try:
        header = next(reader)
        if len(set(header)) != len(header) or not all(name.strip() for name in header):
            raise ValueError(f"the header must name every slot once, got {header}")
        for row in reader:
            if len(row) != len(header):
                raise ValueError(
                    f"line {reader.line_num} has {len(row)} fields, the header has {len(header)}"
                )
            records.append({slot: value for slot, value in zip(header, row, strict=True) if value})
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num} is not valid CSV: {error}") from error
    return tuple(records)


def _parse_goals(text: str) -> tuple[Goal, ...]:
    goals = []
    for number, line in enumerate(text.splitlines(), start=1):
        where = f"line {number}"
        goal = _parse_json(where, line)
        if not isinstance(goal, dict) or set(goal) != {"constraints", "requests"}:
            raise ValueError(f"{where} must have the keys constraints and requests, got {line}")
        constraints, requests = goal["constraints"], goal["requests"]
        if not isinstance(constraints, dict):
            raise ValueError(f"{where}: constraints must map slots to values, got {constraints!r}")
        goals.append(Goal(constraints, _texts(f"{where}: requests", requests)))
    return tuple(goals)


def _parse_values(text: str) -> dict[str, tuple[str, ...]]:
    values = _parse_json("the file", text)
    if not isinstance(values, dict):
        raise ValueError(f"the file must map slots to lists of values, got {values!r}")
    return {slot: _texts(slot, texts) for slot, texts in values.items()}


def _parse_json(where: str, text: str) -> Any:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        names = [name for name, _ in pairs]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"{where} must give every key once, got {twice} again")
        return dict(pairs)

    try:
        return json.loads(text, object_pairs_hook=unique)
    except json.JSONDecodeError as error:
        raise ValueError(f"{where} is not valid JSON: {error}") from error


def _texts(where: str, content: object) -> tuple[str, ...]:
    if not isinstance(content, list) or not all(isinstance(text, str) for text in content):
        raise ValueError(f"{where} must be a list of texts, got {content!r}")
    return tuple(content)


def _check_goal_values(domain: Domain) -> None:
    """Refuses a goal that constrains a slot to a value that neither list nor record has.

    Such a value is a slip of the pen in a corpus that people wrote as a whole.
    """
    known = {(slot, fold(RESERVED_TEXT[DONT_CARE])) for slot in domain.slots}
    known |= {(slot, fold(text)) for slot, texts in domain.error_values.items() for text in texts}
    known |= {(slot, fold(text)) for record in domain.records for slot, text in record.items()}
    for number, goal in enumerate(domain.goals):
        for slot, value in goal.constraints.items():
            if (slot, fold(value)) not in known:
                raise ValueError(
                    f"goal {number} wants {slot} = {value!r}, a value that is neither in "
                    f"{VALUES_FILE} nor in {RECORDS_FILE}"
                )
