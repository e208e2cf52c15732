"""Readers of a domain folder's files: ``domain.yaml``, records, goals and values."""

from __future__ import annotations

import csv
import io
import json
import re
from functools import partial
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.domains.faults import Source
from bbq_torchrl.domains.specification import (
    ACTION_KINDS,
    Action,
    Goal,
    ScriptedPolicySpec,
    repeated,
)
from bbq_torchrl.settings import INTEGER, NUMBER, TEXT, TEXTS, Allowed, check
from bbq_torchrl.utils.files import read_yaml
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bbq_torchrl.domains.faults import Place


SPECIFICATION_FILE = "domain.yaml"

_PLACEHOLDERS: dict[str, Any] = {
    "name": "domain",
    "opening_slot": None,
    "turn_width": 1,
    "policies": {},
    "reference_slot_error_prob": 0.0,
}
"""Values for keys that cannot be read, so that the rest of a domain can be checked."""

_LIST = Allowed("a list of names", lambda value: isinstance(value, list))
_MAPPING = Allowed(
    "a mapping with names as keys",
    lambda value: isinstance(value, dict) and all(isinstance(name, str) for name in value),
)


def read_specification(path: Path) -> Source:
    """Reads ``domain.yaml``.

    Returns:
        The fields of a :class:`~bbq_torchrl.domains.Domain` but ``records``, ``goals`` and
        ``error_values``, and the faults in the file's form. Unreadable fields get a placeholder if
        no other check depends on them; otherwise there are no fields.

    Raises:
        FileNotFoundError: if the file is missing.
    """
    found = Source(path, {})
    text = found.text()
    if text is None:
        return found
    try:
        content = read_yaml(text)
        found.lines = _lines(yaml.compose(text, Loader=yaml.SafeLoader))
    except ValueError as error:
        found.fault(str(error))
    else:
        _read(found, content)
    return found


def _lines(node: yaml.Node | None, parent: Place = ()) -> dict[Place, int]:
    """Returns the line of every key of the first two levels."""
    lines: dict[Place, int] = {}
    for key, value in node.value if isinstance(node, yaml.MappingNode) else ():
        place = (*parent, str(key.value))
        lines[place] = key.start_mark.line + 1
        if not parent:
            lines |= _lines(value, place)
    return lines


def _read(found: Source, content: object) -> None:
    """Reads the fields from a mapping, and adds their faults."""
    readers: dict[str, Callable[[str, Any], Any]] = {
        **dict.fromkeys(("acts", "slots", "essential", "extension_order", "free_slots"), _names),
        **dict.fromkeys(("name", "ticket_slot", "complete_slot"), partial(check, allowed=TEXT)),
        "actions": partial(_actions, found),
        "opening_slot": _opening,
        "turn_width": partial(check, allowed=INTEGER),
        "policies": partial(_policies, found),
        "reference_slot_error_prob": lambda key, value: float(check(key, value, NUMBER)),
    }
    given = found.take((), partial(check, allowed=_MAPPING), "the file", content)
    if given is None:
        return
    for key in given:
        if key not in readers:
            text = f"it has the unknown key {shown(key)}; allowed are {', '.join(readers)}"
            found.fault(text, found.line((key,)))
    if missing := [key for key in readers if key not in given and key != "opening_slot"]:
        found.fault(f"it lacks the keys {', '.join(missing)}")
    fields = {}
    for key in [key for key in readers if key not in missing]:
        before = len(found.faults)
        value = found.take((key,), readers[key], key, given.get(key))
        if len(found.faults) == before or value:
            fields[key] = value
        elif key in _PLACEHOLDERS:
            fields[key] = _PLACEHOLDERS[key]
    if len(fields) == len(readers):
        found.content = fields


def _actions(found: Source, key: str, content: object) -> tuple[Action, ...]:
    given = check(key, content, _MAPPING)
    _check_keys(key, given, ACTION_KINDS, optional=("multiple_choice",))
    names = {
        kind: found.take((key, kind), _names, f"{key}.{kind}", given.get(kind, []))
        for kind in ACTION_KINDS
    }
    if None in names.values():
        return ()
    acts = [Action(name) for name in names.pop("act")]
    return (*acts, *(Action(act, slot) for act in names for slot in names[act]))


def _policies(found: Source, key: str, content: object) -> dict[str, ScriptedPolicySpec]:
    """Returns the readable policies."""
    policies = {
        name: found.take((key, name), _policy, f"{key}.{name}", entry)
        for name, entry in check(key, content, _MAPPING).items()
    }
    return {name: policy for name, policy in policies.items() if policy is not None}


def _policy(key: str, content: object) -> ScriptedPolicySpec:
    policy = check(key, content, _MAPPING)
    _check_keys(key, policy, ("kind", "steps"))
    steps = _names(f"{key}.steps", policy["steps"])
    return ScriptedPolicySpec(check(f"{key}.kind", policy["kind"], TEXT), steps)


def _check_keys(
    where: str, mapping: dict[str, Any], allowed: tuple[str, ...], optional: tuple[str, ...] = ()
) -> None:
    if unknown := [key for key in mapping if key not in allowed]:
        raise ValueError(
            f"{where} has the unknown keys {shown(unknown)}; allowed are {', '.join(allowed)}"
        )
    if missing := [key for key in allowed if key not in mapping and key not in optional]:
        raise ValueError(f"{where} lacks the keys {missing}")


def _names(key: str, content: object) -> tuple[str, ...]:
    names = check(key, content, _LIST)
    return tuple(check(f"every name in {key}", name, TEXT) for name in names)


def _opening(key: str, content: object) -> str | tuple[str, ...] | None:
    if content is None:
        return None
    return _names(key, content) if isinstance(content, list) else check(key, content, TEXT)


RECORDS_FILE = "knowledge_base.csv"
GOALS_FILE = "goals.jsonl"
VALUES_FILE = "values.json"

NEEDS_VALUES = (
    "must list the values of at least one slot: without them an error of mode 'value' has no effect"
)
"""The fault of an empty file of values."""


def read_records(path: Path) -> Source:
    """Reads a knowledge base: a header of slots, then one record per line."""
    table = Source(path)
    text = table.text()
    if text is None:
        return table
    if not text.strip():
        table.fault("the header, a line of slot names, is missing")
        return table
    if not text.endswith("\n"):
        table.fault("the last line must end with a line break; the file looks truncated")
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    records: list[dict[str, str]] = []
    try:
        header = next(reader)
        if len(set(header)) != len(header) or not all(name.strip() for name in header):
            table.fault(f"the header must name every slot once, got {shown(header)}", 1)
            return table
        line = reader.line_num + 1
        for row in reader:
            if len(row) != len(header):
                table.fault(f"it has {len(row)} fields, the header has {len(header)}", line)
            else:
                table.lines["records", len(records)] = line
                pairs = zip(header, row, strict=True)
                records.append({slot: value for slot, value in pairs if value})
            line = reader.line_num + 1
    except csv.Error as error:
        table.fault(f"it is not valid CSV: {error}", reader.line_num)
    table.content = tuple(records)
    return table


def read_goals(path: Path) -> Source:
    """Reads goals, one per line: ``{"constraints": {slot: value}, "requests": [slot]}``."""
    table = Source(path)
    text = table.text()
    goals: list[Goal] = []
    # Not splitlines, which also breaks at characters that JSON allows inside a text.
    lines = text.removesuffix("\n").split("\n") if text else []
    for number, line in enumerate(lines, start=1):
        try:
            goal = _goal(_json(line))
        except ValueError as error:
            table.fault(str(error), number)
        else:
            table.lines["goals", len(goals)] = number
            goals.append(goal)
    table.content = tuple(goals)
    return table


def _goal(content: Any) -> Goal:
    if not isinstance(content, dict) or set(content) != {"constraints", "requests"}:
        raise ValueError(f"it must have the keys constraints and requests, got {shown(content)}")
    constraints = content["constraints"]
    if not isinstance(constraints, dict):
        raise ValueError(f"constraints must map slots to values, got {shown(constraints)}")
    return Goal(constraints, _texts("requests", content["requests"]))


def read_values(path: Path) -> Source:
    """Reads the values that errors substitute: ``{slot: [values]}``."""
    table = _Values(path, {})
    text = table.text()
    if text is None:
        return table
    try:
        values = _json(text)
        if not isinstance(values, dict):
            raise ValueError(f"it must map slots to lists of values, got {shown(values)}")
        if not values:
            raise ValueError(f"it {NEEDS_VALUES}")
    except ValueError as error:
        table.fault(str(error))
        return table
    table.written = text
    read = {
        slot: table.take(("error_values", slot), _texts, slot, texts)
        for slot, texts in values.items()
    }
    table.content = {slot: texts for slot, texts in read.items() if texts is not None}
    return table


class _Values(Source):
    """A file of values, which searches its text for line numbers: ``json`` does not report them."""

    written = ""

    def line(self, place: Place) -> int | None:
        """Returns the line of a slot, or of the first of its values with this text."""
        line, start = None, 0
        for written in place[1:]:
            colon = r"\s*:" if line is None else ""
            match = re.compile(_written(str(written)) + colon).search(self.written, start)
            if match is None:
                break
            line, start = self.written.count("\n", 0, match.start()) + 1, match.end()
        return line


def _written(text: str) -> str:
    """Returns a pattern for a text in JSON, with its letters escaped or not."""
    ways = dict.fromkeys(json.dumps(text, ensure_ascii=ascii) for ascii in (False, True))
    return f"(?:{'|'.join(map(re.escape, ways))})"


def _json(text: str) -> Any:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if twice := repeated(name for name, _ in pairs):
            raise ValueError(f"it must give every key once, got {shown(twice)} again")
        return dict(pairs)

    try:
        return json.loads(text, object_pairs_hook=unique)
    except json.JSONDecodeError as error:
        line = f"line {error.lineno}, " if "\n" in text else ""
        raise ValueError(
            f"it is not valid JSON: {error.msg} at {line}column {error.colno}"
        ) from error
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _texts(where: str, content: object) -> tuple[str, ...]:
    return tuple(check(where, content, TEXTS))
