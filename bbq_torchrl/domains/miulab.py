"""Imports the public MiuLab movie-booking corpus (TC-Bot, MIT licence) without trusting it.

The corpus is a folder of Python 2 pickles. A pickle is a program: loaded plainly it can run
anything. The reader here refuses every global, so that nothing but dicts, lists, texts and
numbers can come out, and then checks each file's form.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from bbq_torchrl.domains.domain import Domain, Goal
from bbq_torchrl.domains.folder import MOVIE_FOLDER
from bbq_torchrl.domains.specification import SPECIFICATION_FILE, read_specification

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["REFERENCE_SLOT_ERROR_PROB", "load_miulab", "read_plain_pickle"]

REFERENCE_SLOT_ERROR_PROB = 0.0581
"""The slot error probability (mode ``value``) at which the rule policy succeeds in 18.3 % of the
dialogues on the default files: 18.31 % of 500,000 at 0.058, and 0.0119 less for every 0.01 more.
"""

_GOAL_KEYS = {"diaact", "inform_slots", "request_slots"}
_UNKNOWN = "UNK"


class _PlainUnpickler(pickle.Unpickler):
    """Unpickles plain data and refuses whatever would import or call something."""

    def find_class(self, module: str, name: str) -> NoReturn:
        raise pickle.UnpicklingError(f"it refers to {module}.{name}, only plain data is allowed")

    def persistent_load(self, pid: Any) -> NoReturn:
        raise pickle.UnpicklingError(f"it refers to the outside object {pid!r}")


def load_miulab(
    path: str | Path,
    goals: str = "user_goals_first_turn_template.v2.p",
    kb: str = "movie_kb.1k.p",
    values: str = "dicts.v3.p",
) -> Domain:
    """Returns the movie domain with MiuLab's records, goals and values.

    Acts, slots, actions and policies are those of our movie domain. Blank values, of which the
    corpus has a few, count as absent. A value that only a goal has is allowed: the corpus is not
    normalised, and some goals cannot be met.

    Args:
        path: the folder that holds the three files.
        goals: file with the list of user goals.
        kb: file with the knowledge base, row number to record.
        values: file with the possible values, slot to list.

    Raises:
        FileNotFoundError: if the folder or one of the files is missing.
        ValueError: if a file is damaged, holds anything but plain data of the expected form, or
            names an act or slot that the domain does not have.
    """
    folder = Path(path).expanduser()
    if missing := [name for name in (goals, kb, values) if not (folder / name).is_file()]:
        raise FileNotFoundError(f"the MiuLab folder {folder} lacks {missing}")
    specification = read_specification(MOVIE_FOLDER / SPECIFICATION_FILE)
    specification |= {
        "name": "miulab",
        "reference_slot_error_prob": REFERENCE_SLOT_ERROR_PROB,
    }
    ticket = specification["ticket_slot"]
    acts = specification["acts"]
    records = _records(folder / kb)
    users = tuple(
        _goal(f"{folder / goals}: goal {number}", entry, acts, ticket)
        for number, entry in enumerate(_expect(folder / goals, read_plain_pickle(folder / goals)))
    )
    error_values = _values(folder / values)
    try:
        return Domain(**specification, records=records, goals=users, error_values=error_values)
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from error


def read_plain_pickle(path: str | Path) -> Any:
    """Returns the dicts, lists, texts and numbers that the pickle file ``path`` holds.

    Nothing is imported, called or built but those. Byte strings of Python 2 are read as UTF-8.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is no pickle, is truncated, has bytes after its end, or refers to
            any class, function or outside object.
    """
    stream = io.BytesIO(Path(path).read_bytes())
    try:
        content = _PlainUnpickler(stream, encoding="utf-8").load()
    except Exception as error:  # a damaged pickle raises nearly anything, from KeyError to EOFError
        raise ValueError(f"{path} is not a pickle of plain data: {error or repr(error)}") from error
    if rest := len(stream.getbuffer()) - stream.tell():
        raise ValueError(f"{path} is not a pickle of plain data: {rest} bytes follow its end")
    return content


def _expect(where: str | Path, content: object) -> list[Any]:
    if not isinstance(content, list):
        raise ValueError(f"{where} must hold a list, got {type(content).__name__}")
    return content


def _expect_mapping(where: str | Path, content: object, key_type: type) -> Mapping[Any, Any]:
    if not isinstance(content, dict):
        raise ValueError(f"{where} must hold a dict, got {type(content).__name__}")
    for key in content:
        if type(key) is not key_type:
            raise ValueError(f"{where} must have {key_type.__name__} keys, got {key!r}")
    return content


def _expect_text(where: str, content: object) -> str:
    if not isinstance(content, str):
        raise ValueError(f"{where} must be a text, got {content!r}")
    return content


def _slot_values(where: str, content: object) -> dict[str, str]:
    """Returns slot to value; blank values are left out."""
    values = _expect_mapping(where, content, str)
    texts = {slot: _expect_text(f"{where}, {slot}", value) for slot, value in values.items()}
    return {slot: text for slot, text in texts.items() if text.strip()}


def _records(path: Path) -> tuple[dict[str, str], ...]:
    table = _expect_mapping(path, read_plain_pickle(path), int)
    return tuple(_slot_values(f"{path}: row {row}", table[row]) for row in sorted(table))


def _values(path: Path) -> dict[str, tuple[str, ...]]:
    """Returns slot to values; a value that is listed twice stays so and is drawn twice as often."""
    lists = _expect_mapping(path, read_plain_pickle(path), str)
    values = {
        slot: [_expect_text(f"{path}: {slot}", text) for text in _expect(f"{path}: {slot}", entry)]
        for slot, entry in lists.items()
    }
    return {slot: tuple(text for text in texts if text.strip()) for slot, texts in values.items()}


def _goal(where: str, content: object, acts: tuple[str, ...], ticket: str) -> Goal:
    goal = _expect_mapping(where, content, str)
    if set(goal) != _GOAL_KEYS:
        raise ValueError(f"{where} must have the keys {sorted(_GOAL_KEYS)}, got {sorted(goal)}")
    if goal["diaact"] not in acts:
        raise ValueError(f"{where} has the unknown act {goal['diaact']!r}; allowed: {list(acts)}")
    if goal["diaact"] != "request":
        raise ValueError(f"{where} must open with the act request, got {goal['diaact']!r}")
    requests = _slot_values(f"{where}, request_slots", goal["request_slots"])
    if odd := {slot: value for slot, value in requests.items() if value != _UNKNOWN}:
        raise ValueError(f"{where} must request slots with the value {_UNKNOWN!r}, got {odd}")
    return Goal(
        constraints=_slot_values(f"{where}, inform_slots", goal["inform_slots"]),
        requests=tuple(slot for slot in requests if slot != ticket),
    )
