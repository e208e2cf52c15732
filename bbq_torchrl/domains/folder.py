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
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from os.path import expanduser
from pathlib import Path
from typing import Any

from bbq_torchrl.domains.domain import (
    ACTION_KINDS,
    Action,
    Domain,
    DomainError,
    Fault,
    Goal,
    ScriptedPolicySpec,
    Source,
    sentences,
)
from bbq_torchrl.domains.values import DIFFERENCE, misspellings, unlisted
from bbq_torchrl.settings import (
    MAPPING,
    REQUIRED,
    TEXT,
    TEXTS,
    Allowed,
    check,
    faults,
    filled,
    setting,
)
from bbq_torchrl.utils.files import csv_text, read_yaml, write_text
from bbq_torchrl.utils.text import FaultsError, shown

_Tell = Callable[..., None]

SPECIFICATION_FILE = "domain.yaml"
RECORDS_FILE = "knowledge_base.csv"
GOALS_FILE = "goals.jsonl"
VALUES_FILE = "values.json"

SHIPPED = {name: Path(__file__).parent / name for name in ("movie", "hotel", "restaurant")}
"""Domain that comes with the package -> its folder."""

Corpus = dict[str, dict[Any, Any]]
"""The fields ``records``, ``goals`` and ``error_values``, each entry by its line, row or slot."""

_IN_NO_FILE = f"a value that is neither in {VALUES_FILE} nor in {RECORDS_FILE}"
_ANY = Allowed("anything", lambda value: True)  # Domain checks it
_OPENING = Allowed(
    "a slot, a list of slots or null",
    lambda value: value is None or TEXT.test(value) or TEXTS.test(value),
)
_LISTS = Allowed(
    "a mapping from slots to values, not empty, as errors have no effect without values",
    lambda value: MAPPING.test(value) and bool(value),
)


@dataclass
class _Specification:
    """The keys of ``domain.yaml``."""

    name: str = setting(REQUIRED, TEXT, "name in results")
    acts: list[str] = setting(REQUIRED, TEXTS, "dialogue acts")
    slots: list[str] = setting(REQUIRED, TEXTS, "slots, in the order of features")
    actions: Any = setting(REQUIRED, MAPPING, "acts, then slots by act")
    essential: list[str] = setting(REQUIRED, TEXTS, "slots that are active from the first round")
    extension_order: list[str] = setting(REQUIRED, TEXTS, "slots that domain extension adds")
    free_slots: list[str] = setting(REQUIRED, TEXTS, "slots that never constrain the records")
    ticket_slot: str = setting(REQUIRED, TEXT, "the booking")
    complete_slot: str = setting(REQUIRED, TEXT, "the slot whose inform offers a booking")
    opening_slot: Any = setting(None, _OPENING, "slots informed in every first turn")
    turn_width: int = setting(REQUIRED, _ANY, "length of the one-hot turn")
    policies: Any = setting(REQUIRED, MAPPING, "scripted policies by name")
    reference_slot_error_prob: float = setting(REQUIRED, _ANY, "the calibrated difficulty")


@dataclass
class _Actions:
    """The keys of ``actions``."""

    act: list[str] = setting(REQUIRED, TEXTS, "acts without a slot")
    request: list[str] = setting(REQUIRED, TEXTS, "slots that can be requested")
    inform: list[str] = setting(REQUIRED, TEXTS, "slots that can be informed")
    multiple_choice: list[str] = setting([], TEXTS, "slots of which values can be offered")


@dataclass
class _Policy:
    """The keys of a scripted policy."""

    kind: str = setting(REQUIRED, TEXT, "kind of policy")
    steps: list[str] = setting(REQUIRED, TEXTS, "actions of a script, slots of another policy")


@dataclass
class _Goal:
    """The keys of a goal."""

    constraints: Any = setting(REQUIRED, MAPPING, "slot to value")
    requests: list[str] = setting(REQUIRED, TEXTS, "the slots asked for")


def load_domain(path: str | Path) -> Domain:
    """Loads the domain in the folder ``path``.

    Args:
        path: a folder with the four files listed in this module's docstring.

    Raises:
        FileNotFoundError: if the folder or one of its files is missing.
        FaultsError: a ``ValueError``, if files are damaged or contradict each other. It lists all
            damage, or else all contradictions, each with file, line and what is allowed.
    """
    folder = Path(expanduser(path))
    readers: dict[str, Callable[[str, _Tell], Any]] = {
        SPECIFICATION_FILE: _specification,
        RECORDS_FILE: _records,
        GOALS_FILE: _goals,
        VALUES_FILE: _values,
    }
    if missing := [name for name in readers if not (folder / name).is_file()]:
        raise FileNotFoundError(f"the domain folder {folder} lacks {', '.join(missing)}")
    damage: list[str] = []
    contents = []
    for name, read in readers.items():
        tell = partial(_tell, damage, name)
        try:
            contents.append(read(read_text(folder / name), tell))
        except ValueError as error:
            tell(str(error))
    if damage:
        raise FaultsError(str(folder), damage)
    specification, *data = contents
    corpus: Corpus = dict(zip(("records", "goals", "error_values"), data, strict=True))
    content = content_of(corpus)
    found = [
        *(
            Fault("goals", f"it wants {slot} = {shown(value)}, {_IN_NO_FILE}", number)
            for number, slot, value in unlisted(**content)
            if slot in specification["slots"]
        ),
        *(
            Fault(
                item.field,
                f"it has {item}: they differ {DIFFERENCE}, so write both alike",
                item.entry,
            )
            for item in misspellings(**content)
        ),
    ]
    try:
        domain = Domain(**specification, **content, folder=folder)
    except DomainError as error:
        found = [*error.found, *found]
    if found:
        sources = {
            "records": Source(RECORDS_FILE, "line", list(corpus["records"])),
            "goals": Source(GOALS_FILE, "line", list(corpus["goals"])),
            "error_values": Source(VALUES_FILE),
        }
        raise FaultsError(str(folder), sentences(found, sources, SPECIFICATION_FILE))
    return domain


@cache
def shipped_domain(name: str) -> Domain:
    """Returns one of the :data:`SHIPPED` domains."""
    return load_domain(SHIPPED[name])


def named_domain(name: str, within: str | Path = "") -> Domain:
    """Returns the shipped domain of a name, otherwise the domain in a folder.

    Args:
        name: one of :data:`SHIPPED`, or a folder.
        within: the folder that a relative folder is in. Defaults to the current one.

    Raises:
        FileNotFoundError or FaultsError: as :func:`load_domain`.
    """
    return shipped_domain(name) if name in SHIPPED else load_domain(Path(within, expanduser(name)))


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


def content_of(corpus: Corpus) -> dict[str, Any]:
    """Returns a corpus as fields of a :class:`~bbq_torchrl.domains.Domain`."""
    records, goals = (tuple(corpus[field].values()) for field in ("records", "goals"))
    return {"records": records, "goals": goals, "error_values": corpus["error_values"]}


def read_text(path: Path) -> str:
    """Returns a file's text, without a byte-order mark and with its line ends as they are."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        return file.read()


def _tell(damage: list[str], name: str, text: str, line: int | None = None) -> None:
    """Adds the damage of a file, or of one of its lines."""
    damage.append(f"{name}: {text}" if line is None else f"{name}, line {line}: {text}")


def _specification(text: str, tell: _Tell) -> dict[str, Any]:
    """Reads ``domain.yaml``: all fields of a domain but those of a corpus."""
    content = check("the file", read_yaml(text), MAPPING)
    found = faults(_Specification, content)
    if not found:
        found = faults(_Actions, content["actions"], "actions.")
        for name, policy in content["policies"].items():
            key = f"policies.{name}"
            found |= faults(_Policy, check(key, policy, MAPPING), f"{key}.")
    if found:
        for fault in found.values():
            tell(fault)
        return {}
    return fields_of(content)


def fields_of(content: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the fields of a domain, but those of a corpus, that ``domain.yaml`` describes."""
    acts = [Action(act) for act in content["actions"]["act"]]
    for kind in ACTION_KINDS[1:]:
        acts += [Action(kind, slot) for slot in content["actions"].get(kind, [])]
    fields = vars(_Specification(**content))
    opening = fields.pop("opening_slot") or ()
    return {
        **{key: tuple(item) if isinstance(item, list) else item for key, item in fields.items()},
        "actions": tuple(acts),
        "opening_slots": (opening,) if isinstance(opening, str) else tuple(opening),
        "policies": {
            str(name): ScriptedPolicySpec(policy["kind"], tuple(policy["steps"]))
            for name, policy in content["policies"].items()
        },
    }


def _records(text: str, tell: _Tell) -> dict[int, dict[str, str]]:
    """Reads a knowledge base: a header of slots, then one record per line."""
    if text and not text.endswith("\n"):
        tell("the last line must end with a line break; the file looks truncated")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    records = {}
    try:
        header = next(reader, [])
        if not header or len(set(header)) != len(header) or not all(map(str.strip, header)):
            raise ValueError(f"the header must name every slot once, got {shown(header)}")
        line = reader.line_num + 1
        for row in reader:
            if len(row) != len(header):
                tell(f"it has {len(row)} fields, the header has {len(header)}", line)
            records[line] = {slot: value for slot, value in zip(header, row, strict=False) if value}
            line = reader.line_num + 1
    except csv.Error as error:
        tell(str(error), reader.line_num)
    return records


def _goals(text: str, tell: _Tell) -> dict[int, Goal]:
    """Reads goals, one per line: ``{"constraints": {slot: value}, "requests": [slot]}``."""
    goals = {}
    # Not splitlines, which also breaks at characters that JSON allows inside a text.
    for line, written in enumerate(text.removesuffix("\n").split("\n") if text else (), start=1):
        try:
            goal = filled(_Goal, check("a goal", _json(written), MAPPING))
            goals[line] = Goal(goal.constraints, tuple(goal.requests))
        except ValueError as error:
            tell(str(error), line)
    return goals


def _values(text: str, tell: _Tell) -> dict[str, tuple[str, ...]]:
    """Reads the values that errors substitute: ``{slot: [values]}``."""
    lists = check("the file", _json(text), _LISTS)
    return {slot: tuple(check(slot, values, TEXTS)) for slot, values in lists.items()}


def _json(text: str) -> Any:
    """Parses JSON without repeated keys."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(entries := dict(pairs)) < len(pairs):
            raise ValueError(
                f"every key must be given once, got {shown([key for key, _ in pairs])}"
            )
        return entries

    try:
        return json.loads(text, object_pairs_hook=unique)
    except RecursionError as error:
        raise ValueError(str(error)) from error


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
    dump = partial(json.dumps, ensure_ascii=False)
    lines = (
        dump({"constraints": dict(goal.constraints), "requests": list(goal.requests)}) + "\n"
        for goal in goals
    )
    values = {slot: list(texts) for slot, texts in error_values.items()}
    for name, text in (
        (RECORDS_FILE, csv_text(records, slots)),
        (GOALS_FILE, "".join(lines)),
        (VALUES_FILE, dump(values, indent=1) + "\n"),
    ):
        write_text(Path(folder, name), text)
