"""Tables of configuration keys, and the files of ``conf/<group>/``, from the options."""

from __future__ import annotations

import re
from dataclasses import Field, fields
from typing import TYPE_CHECKING, Any

from bbq_torchrl.options import CalibrateConfig, Config, EvaluateConfig, explorations, schemas
from bbq_torchrl.options.registry import EXPERIMENT, conf_folder, options
from bbq_torchrl.options.root import defaults
from bbq_torchrl.runs.compose import compose, default as written, summary
from bbq_torchrl.search.definition import SEARCH, SearchConfig
from bbq_torchrl.settings import REQUIRED
from scripts.docs_blocks.common import block, code, table

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.options import Option


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
    summaries = [f"- `{group}={name}`: {summary(schema)}" for name, schema in known.items()]
    shown = _table(known, f"{group}.")
    return "\n".join(summaries) + f"\n\n{shown}"


for _name in schemas():
    block(f"config.{_name}", _name)(_group)


def _table(options_of: dict[str, type], prefix: str) -> str:
    """Returns a row for each key; options are named where not all have the same default."""
    by_option = {name: {item.name: item for item in fields(of)} for name, of in options_of.items()}
    rows = []
    for key in dict.fromkeys(key for items in by_option.values() for key in items):
        if key in {"name", *schemas()}:
            continue
        having = {name: items[key] for name, items in by_option.items() if key in items}
        shown: dict[str, list[str]] = {}
        for name, item in having.items():
            shown.setdefault(_default(item), []).append(name)
        if len(shown) == 1 and len(having) == len(by_option):
            default = next(iter(shown))
        else:
            default = "; ".join(f"{value} ({', '.join(names)})" for value, names in shown.items())
        told = (
            dict.fromkeys(_allowed(item) for item in having.values()),
            dict.fromkeys(item.metadata["meaning"] for item in having.values()),
        )
        rows.append((code(f"{prefix}{key}"), default, *map(" / ".join, told)))
    return table(("key", "default", "must be", "meaning"), rows)


def _allowed(item: Field[Any]) -> str:
    """Returns what a key takes, with a star where a list, one for each replica, is taken too."""
    text: str = item.metadata["allowed"].text
    return text.replace(" (or a list, one for each replica)", "*").removeprefix("a ")


def _default(item: Field[Any]) -> str:
    text = written(item)
    return "none: must be given" if text == REQUIRED else code(text)


def option_files() -> dict[Path, str]:
    """Returns the files of ``conf/<group>/`` with their text, a key a line."""
    folder = conf_folder()
    return {
        folder / group / f"{name}.yaml": _option_file(schema)
        for group, known in schemas().items()
        for name, schema in known.items()
        if schema.__module__.startswith("bbq_torchrl.options.")
    }


def _option_file(schema: type[Option]) -> str:
    place = f"{schema.__module__.replace('.', '/')}.py"
    lines = [
        f"# {summary(schema)}",
        f"# The keys of {schema.__qualname__} in {place}; written by scripts/write_docs.py.",
        "defaults:",
    ]
    for entry in defaults(schema):
        (given,) = [entry] if isinstance(entry, str) else [": ".join(*entry.items())]
        lines.append(f"  - {given}")
    lines.append("")
    for item in fields(schema):
        comment = "" if item.name == "name" else f"  # {item.metadata['meaning']}"
        lines.append(f"{item.name}: {written(item)}{comment}")
    return "\n".join(lines) + "\n"


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
