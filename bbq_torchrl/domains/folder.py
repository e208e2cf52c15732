"""Loading and saving a domain as a folder of plain files.

=====================  ==========================================================================
``domain.yaml``        acts, slots, actions, special slots, policies, difficulty
``knowledge_base.csv`` a header of slots, then one record per line; empty fields are absent values
``goals.jsonl``        one ``{"constraints": {slot: value}, "requests": [slot]}`` per line
``values.json``        ``{slot: [value]}``: the values that an error can substitute
=====================  ==========================================================================
"""

from __future__ import annotations

import csv
import functools
import io
import json
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING

from bbq_torchrl.domains.domain import Domain
from bbq_torchrl.domains.faults import DomainError, Fault
from bbq_torchrl.domains.files import (
    GOALS_FILE,
    RECORDS_FILE,
    SPECIFICATION_FILE,
    VALUES_FILE,
    read_goals,
    read_records,
    read_specification,
    read_values,
)
from bbq_torchrl.domains.values import DIFFERENCE, RESERVED_TEXT, misspellings, plain
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from bbq_torchrl.domains.specification import Goal

SHIPPED = {name: Path(__file__).parent / name for name in ("movie", "hotel", "restaurant")}
"""Domain that comes with the package -> its folder."""

MOVIE_FOLDER = SHIPPED["movie"]


def load_domain(path: str | Path) -> Domain:
    """Loads the domain in the folder ``path``.

    Args:
        path: a folder with the four files listed in this module's docstring.

    Raises:
        FileNotFoundError: if the folder or one of its files is missing.
        DomainError: a ``ValueError``, if a file is damaged or the files contradict each other. It
            lists all faults, each with file, line and what is allowed.
    """
    folder = Path(expanduser(path))
    names = (SPECIFICATION_FILE, RECORDS_FILE, GOALS_FILE, VALUES_FILE)
    if missing := [name for name in names if not (folder / name).is_file()]:
        raise FileNotFoundError(f"the domain folder {folder} lacks {', '.join(missing)}")
    specification = read_specification(folder / SPECIFICATION_FILE)
    tables = {
        "records": read_records(folder / RECORDS_FILE),
        "goals": read_goals(folder / GOALS_FILE),
        "error_values": read_values(folder / VALUES_FILE),
    }
    faults = [fault for source in (specification, *tables.values()) for fault in source.faults]
    content = {name: table.content for name, table in tables.items()}
    found: list[Fault] = []
    if specification.content:
        try:
            domain = Domain(**specification.content, **content, folder=folder)
        except DomainError as error:
            # A table that could not be read is empty, which is not a second fault.
            unread = {(name,) for name, table in tables.items() if table.faults}
            found += [fault for fault in error.found if fault.place not in unread]
        if not (tables["records"].faults or tables["error_values"].faults):
            found += _unknown_values(specification.content["slots"], **content)
        found += [
            Fault(
                item.place,
                f"it has {item}: they differ {DIFFERENCE}, so write both alike",
            )
            for item in misspellings(**content)
        ]
    for place, text, *_ in found:
        source = tables.get(str(place[0]), specification)
        faults.append(Fault(place, text, source.name, "line", source.line(place)))
    if faults:
        raise DomainError(str(folder), faults)
    return domain


@functools.cache
def shipped_domain(name: str) -> Domain:
    """Returns one of the :data:`SHIPPED` domains."""
    return load_domain(SHIPPED[name])


def movie_domain() -> Domain:
    """Returns the movie-booking domain that comes with the package.

    Examples:
        >>> domain = movie_domain()
        >>> len(domain.acts), len(domain.slots), len(domain.actions)
        (11, 29, 39)
        >>> str(domain.actions[domain.action_index("inform(ticket)")])
        'inform(ticket)'
    """
    return shipped_domain("movie")


def save_data(
    folder: str | Path,
    slots: Sequence[str],
    records: Iterable[Mapping[str, str]],
    goals: Iterable[Goal],
    error_values: Mapping[str, Sequence[str]],
) -> None:
    """Writes a domain's records, goals and values into ``folder``, which must exist.

    ``domain.yaml``, which people write by hand, stays as it is. Equal data give equal bytes.

    Args:
        folder: the folder of the three files.
        slots: the columns of the records, in order; slots without values may be left out.
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


def _unknown_values(
    slots: Sequence[str],
    records: Sequence[Mapping[str, str]],
    goals: Sequence[Goal],
    error_values: Mapping[str, Sequence[str]],
) -> list[Fault]:
    """Finds goals that constrain a slot to a value that no list and no record has.

    In a hand-written corpus such a value is a typing error. Values that differ only in spelling are
    reported as misspellings instead.
    """
    # Reserved values are either refused elsewhere or have a meaning.
    known = {(slot, plain(text)) for slot in slots for text in RESERVED_TEXT.values()}
    known |= {(slot, plain(text)) for slot, texts in error_values.items() for text in texts}
    known |= {(slot, plain(text)) for record in records for slot, text in record.items()}
    return [
        Fault(
            ("goals", number),
            f"it wants {slot} = {shown(value)}, a value that is neither in {VALUES_FILE} nor in "
            f"{RECORDS_FILE}",
        )
        for number, goal in enumerate(goals)
        for slot, value in goal.constraints.items()
        if slot in slots and isinstance(value, str) and (slot, plain(value)) not in known
    ]
