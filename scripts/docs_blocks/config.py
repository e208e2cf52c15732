"""Tables of configuration keys, from the options."""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import MISSING, Field, fields
from typing import Any

from bbq_torchrl.options import CalibrateConfig, Config, EvaluateConfig, explorations, schemas
from bbq_torchrl.options.registry import EXPERIMENT, options
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.search.definition import SEARCH, SearchConfig
from bbq_torchrl.settings import REQUIRED
from scripts.docs_blocks.common import block, code, table


@block("config.root", Config)
@block("config.evaluate", EvaluateConfig)
@block("config.calibrate", CalibrateConfig)
@block("config.search", SearchConfig, f"{SEARCH}.")
def _keys(schema: type, prefix: str = "") -> str:
    """Returns a row for each key of a root, without the groups."""
    return _table({"default": schema}, prefix)


def _group(group: str) -> str:
    """Returns a summary of each option, and a table of all keys with each option's default."""
    known = {name: schemas()[group][name] for name in options(group)}
    meaning = {
        name: (inspect.getdoc(schema) or "").split("\n\n")[0] for name, schema in known.items()
    }
    summaries = [f"- `{group}={name}`: {' '.join(text.split())}" for name, text in meaning.items()]
    shown = _table({code(name): schema for name, schema in known.items()}, f"{group}.")
    return "\n".join(summaries) + f"\n\n{shown}"


for _name in schemas():
    block(f"config.{_name}", _name)(_group)


def _table(columns: dict[str, type], prefix: str) -> str:
    of_columns = [{item.name: item for item in fields(schema)} for schema in columns.values()]
    rows = []
    for key in dict.fromkeys(key for items in of_columns for key in items):
        if key in {"name", *schemas()}:
            continue
        same = [items[key].metadata for items in of_columns if key in items]
        defaults = (_default(items[key]) if key in items else "–" for items in of_columns)
        told = (
            dict.fromkeys(entry["allowed"].text for entry in same),
            dict.fromkeys(entry["meaning"] for entry in same),
        )
        rows.append((code(f"{prefix}{key}"), *defaults, *map(" / ".join, told)))
    return table(("key", *columns, "must be", "meaning"), rows)


def _default(item: Field[Any]) -> str:
    value = item.default if item.default_factory is MISSING else item.default_factory()
    if value == REQUIRED:
        return "none: must be given"
    return code(json.dumps(value) if value is None or isinstance(value, bool) else value)


@block("config.pairs")
def _pairs() -> str:
    shown = {agent: [code(name) for name in names] for agent, names in explorations().items()}
    rows = [(code(agent), names[0], ", ".join(names[1:])) for agent, names in shown.items()]
    return table(("agent", "explores by", "or by"), rows)


@block("config.groups")
def _groups() -> str:
    chosen = compose()
    rows = [(code(g), _names(options(g)), code(getattr(chosen, g).name)) for g in schemas()]
    rows.append((code(f"+{EXPERIMENT}"), _names(options(EXPERIMENT)), "none"))
    return table(("group", "options", "default"), rows)


def _names(names: list[str]) -> str:
    """Returns the names as code, with one name per folder at the end."""
    shown = dict.fromkeys(re.sub("/.*", "/…", name) for name in names)
    return ", ".join(code(name) for name in sorted(shown, key=lambda name: "/" in name))
