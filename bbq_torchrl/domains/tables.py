"""Readers of a domain's records, goals and values."""

from __future__ import annotations

import csv
import io
import json
import re
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.faults import Source
from bbq_torchrl.domains.parts import Goal, repeated
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.domains.faults import Place

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
    """Reads goals, one a line: ``{"constraints": {slot: value}, "requests": [slot]}``."""
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
    if not isinstance(content, list) or not all(isinstance(text, str) for text in content):
        raise ValueError(f"{where} must be a list of texts, got {shown(content)}")
    return tuple(content)
