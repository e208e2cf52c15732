"""Tables of configuration keys, from the options."""

from __future__ import annotations

import inspect
from collections import Counter
from dataclasses import Field, fields
from functools import cache
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from bbq_torchrl.cli.searches import SEARCH, SearchConfig
from bbq_torchrl.cli.store import compose_raw, options, session
from bbq_torchrl.options import CalibrateConfig, Config, EvaluateConfig, explorations, schemas
from bbq_torchrl.options.registry import EXPERIMENT
from bbq_torchrl.options.values import keys_with_lists
from scripts.docs_blocks.common import block, code, table

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


@block("config.root", Config, "config", "agent=bbqn")
@block("config.evaluate", EvaluateConfig, "evaluate")
@block("config.calibrate", CalibrateConfig, "calibrate")
def _root(schema: type, name: str, *overrides: str) -> str:
    with session():
        composed = compose_raw(overrides, name)
    keys = [item for item in fields(schema) if item.name not in schemas()]
    return _table(keys, {"default": composed})


@block("config.search")
def _search() -> str:
    defaults = OmegaConf.structured(SearchConfig)
    return _table(fields(SearchConfig), {"default": defaults}, f"{SEARCH}.")


def _group(group: str) -> str:
    """Returns what each option is, and one table of all keys with each option's default."""
    nodes = {name: _composed()[group, name] for name in options(group)}
    types = {name: OmegaConf.get_type(node) for name, node in nodes.items()}
    summaries = [f"- `{group}={name}`: {_summary(schema)}" for name, schema in types.items()]
    keys = [item for schema in types.values() for item in fields(schema) if item.name != "name"]
    shown = _table(keys, {code(name): node for name, node in nodes.items()}, f"{group}.")
    return "\n".join(summaries) + (f"\n\n{shown}" if keys else "")


for _name in schemas():
    block(f"config.{_name}", _name)(_group)


@cache
def _composed() -> dict[tuple[str, str], DictConfig]:
    """Returns every option of every group with its defaults; one of each group at a time."""
    found = {}
    names = {group: options(group) for group in schemas()}
    with session():
        for number in range(max(map(len, names.values()))):
            chosen = {group: known[min(number, len(known) - 1)] for group, known in names.items()}
            raw = compose_raw([f"{group}={name}" for group, name in chosen.items()])
            found |= {(group, name): raw[group] for group, name in chosen.items()}
    return found


def _summary(schema: type) -> str:
    return (inspect.getdoc(schema) or "").partition("\n\n")[0].replace("\n", " ")


def _table(items: Iterable[Field[Any]], columns: Mapping[str, DictConfig], prefix: str = "") -> str:
    """Returns a row for each key, with its default in each column's configuration."""
    keys: dict[str, list[Any]] = {}
    for item in items:
        keys.setdefault(item.name, []).append(item.metadata)
    rows = [
        (
            code(f"{prefix}{key}"),
            *(_default(node, key) for node in columns.values()),
            " / ".join(dict.fromkeys(entry["allowed"].text for entry in same)),
            " / ".join(dict.fromkeys(entry["meaning"] for entry in same)),
        )
        for key, same in keys.items()
    ]
    return table(("key", *columns, "must be", "meaning"), rows)


def _default(node: DictConfig, key: str) -> str:
    if key not in node.keys():  # noqa: SIM118 - a default that must be given is a key, too
        return "–"
    if OmegaConf.is_missing(node, key):
        return "none: must be given"
    value = node._get_node(key)._value() if OmegaConf.is_interpolation(node, key) else node[key]
    if value is None:
        return code("null")
    return code(str(value).lower() if isinstance(value, bool) else value)


@block("config.pairs")
def _pairs() -> str:
    rows = [
        (code(agent), code(names[0]), ", ".join(map(code, names[1:])))
        for agent, names in explorations().items()
    ]
    return table(("agent", "explores by", "or by"), rows)


@block("config.lists")
def _lists() -> str:
    rows = []
    for key, names in keys_with_lists(schemas()).items():
        group, _, name = key.partition(".")
        (item,) = (item for item in fields(schemas()[group][names[0]]) if item.name == name)
        of = ", ".join(code(f"{group}={option}") for option in names)
        rows.append((code(key), of, item.metadata["meaning"]))
    return table(("key", "of", "meaning"), rows)


@block("config.groups")
def _groups() -> str:
    with session():
        chosen = compose_raw([], with_hydra=True).hydra.runtime.choices
    rows = [
        (
            code(f"+{group}" if group == EXPERIMENT else group),
            ", ".join(_by_folder(options(group))),
            code(chosen[group]) if chosen.get(group) else "none",
        )
        for group in (*schemas(), EXPERIMENT)
    ]
    return table(("group", "options", "default"), rows)


def _by_folder(names: Iterable[str]) -> list[str]:
    """Returns the names as code, and those of a folder as one, with their number."""
    folders = Counter(name.rpartition("/")[0] for name in names)
    plain = [code(name) for name in names if "/" not in name]
    return plain + [f"{code(f'{name}/…')} ({n})" for name, n in folders.items() if name]
