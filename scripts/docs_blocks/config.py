"""Tables of configuration keys, from the options."""

from __future__ import annotations

import inspect
from collections import Counter
from dataclasses import Field, fields
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from bbq_torchrl.cli.searches import SEARCH, SearchConfig
from bbq_torchrl.cli.store import compose_raw, options, session
from bbq_torchrl.options import (
    CalibrateConfig,
    Config,
    EvaluateConfig,
    explorations,
    schemas,
)
from bbq_torchrl.options.registry import EXPERIMENT
from bbq_torchrl.options.values import keys_with_lists
from scripts.docs_blocks.markdown import code, table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

__all__ = ["config_blocks"]

_HEAD = ("key", "default", "must be", "meaning")


def config_blocks() -> dict[str, Callable[[], str]]:
    """Returns a block for every group, for both roots, and for what can be paired."""
    blocks: dict[str, Callable[[], str]] = {
        "config.root": partial(_root, Config, "config", ["agent=bbqn"]),
        "config.evaluate": partial(_root, EvaluateConfig, "evaluate", []),
        "config.calibrate": partial(_root, CalibrateConfig, "calibrate", []),
        "config.search": _search,
        "config.pairs": _pairs,
        "config.groups": _groups,
        "config.lists": _lists,
    }
    return blocks | {f"config.{group}": partial(_group, group) for group in schemas()}


def _root(schema: type, name: str, overrides: list[str]) -> str:
    with session():
        composed = compose_raw(overrides, name)
    leaves = [item for item in fields(schema) if item.name not in schemas()]
    return table(_HEAD, _rows(leaves, composed))


def _search() -> str:
    defaults = OmegaConf.structured(SearchConfig)
    rows = _rows(fields(SearchConfig), defaults)
    return table(_HEAD, [(code(f"{SEARCH}.{key.strip('`')}"), *rest) for key, *rest in rows])


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


def _group(group: str) -> str:
    """Returns what each option is, and one table of all keys with each option's default."""
    names = options(group)
    nodes = [_composed()[group, name] for name in names]
    schemas = [OmegaConf.get_type(node) for node in nodes]
    summaries = [
        f"- `{group}={name}`: {_summary(schema)}"
        for name, schema in zip(names, schemas, strict=True)
    ]
    keys = [item for schema in schemas for item in fields(schema) if item.name != "name"]
    rows = []
    for name in dict.fromkeys(item.name for item in keys):
        same = [item.metadata for item in keys if item.name == name]
        defaults = [_default(node, name) if name in node else "–" for node in nodes]
        allowed = " / ".join(dict.fromkeys(entry["allowed"].text for entry in same))
        meaning = " / ".join(dict.fromkeys(entry["meaning"] for entry in same))
        rows.append((code(f"{group}.{name}"), *defaults, allowed, meaning))
    head = ("key", *(code(name) for name in names), "must be", "meaning")
    return "\n".join(summaries) + ("\n\n" + table(head, rows) if rows else "")


def _rows(items: Iterable[Field[Any]], node: DictConfig) -> Iterable[tuple[str, ...]]:
    for item in items:
        allowed, meaning = item.metadata["allowed"].text, item.metadata["meaning"]
        yield code(item.name), _default(node, item.name), allowed, meaning


def _default(node: DictConfig, key: str) -> str:
    if OmegaConf.is_missing(node, key):
        return "none: must be given"
    value = node._get_node(key)._value() if OmegaConf.is_interpolation(node, key) else node[key]
    if value is None:
        return code("null")
    return code(str(value).lower() if isinstance(value, bool) else value)


def _summary(schema: type) -> str:
    return (inspect.getdoc(schema) or "").split("\n\n", maxsplit=1)[0].replace("\n", " ")


def _pairs() -> str:
    strategies = sorted({name for names in explorations().values() for name in names})
    rows = [
        (
            code(name),
            *(
                "default" if name == names[0] else "yes" if name in names else "refused"
                for names in explorations().values()
            ),
        )
        for name in strategies
    ]
    return table(("explore", *(code(f"agent={agent}") for agent in explorations())), rows)


def _lists() -> str:
    rows = []
    for key, names in keys_with_lists(schemas()).items():
        group, _, name = key.partition(".")
        items = [item for item in fields(schemas()[group][names[0]]) if item.name == name]
        options_with_it = ", ".join(code(f"{group}={option}") for option in names)
        rows.append((code(key), options_with_it, items[0].metadata["meaning"]))
    return table(("key", "of", "meaning"), rows)


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
