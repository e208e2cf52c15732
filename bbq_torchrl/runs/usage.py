"""The help of ``bbq train``: groups, options, experiments, and the meaning of keys."""

from __future__ import annotations

import inspect
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, Field, fields
from textwrap import wrap
from typing import Any

from bbq_torchrl.options import Config, schemas
from bbq_torchrl.options.registry import EXPERIMENT, options
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils.output import page
from bbq_torchrl.utils.text import shown

_BEGIN = """\
Trains an agent on task-oriented dialogues and evaluates it.

usage: bbq train [<group>=<option> ...] [<key>=<value> ...] [--multirun]
       bbq train --help [<group> | <group>=<option> | <key> ...]    meaning and values of keys
"""

_END = f"""\
Examples
  bbq train agent=bbqn explore=thompson env=domain_ext
  bbq train protocol.rounds=20 replicas=3 domain=miulab domain.path=<folder>
  bbq train replicas=4 'agent.prior_std=[.05,.1,.2,.4]'
  bbq train --multirun agent=bbqn,dqn 'seed=range(0,3)'
  bbq train resume=<run folder>

--cfg job prints all keys of a command. All keys: {page("configuration")}
"""


def usage(words: Sequence[str] = ()) -> str:
    """Returns the help of ``bbq train``.

    Args:
        words: groups, options (``agent=dqn``) and keys (``agent.lr``) to explain; without any, all
            groups and options are listed.

    Raises:
        ConfigError: a word names no group, option or key.
    """
    lines = [line for word in words for line in _explained(word)]
    return "\n".join(lines or [_BEGIN, *_overview(), "", _END.rstrip()]) + "\n"


def _overview() -> Iterator[str]:
    yield from _keys(Config)
    for group, known in schemas().items():
        yield f"\n{group}="
        yield from (f"  {name:<20} {summary(schema)}" for name, schema in known.items())
    places = defaultdict(list)
    for name in options(EXPERIMENT):
        folder, _, file = name.rpartition("/")
        places[folder].append(file)
    yield f"\n+{EXPERIMENT}="
    for folder, names in places.items():
        start = f"  {folder + '/' if folder else '':<20} "
        yield from wrap(", ".join(names), 100, initial_indent=start, subsequent_indent=" " * 23)


def _explained(word: str) -> Iterator[str]:
    """Yields the lines about a group, an option or a key."""
    name, _, value = word.partition("=")
    group, _, key = name.partition(".")
    known = schemas().get(group, {})
    chosen = {value: known[value]} if value in known else known
    having: dict[str, list[str]] = defaultdict(list)
    if name in _by_name(Config):
        yield from _keys(Config, key=name)
    elif not key and chosen:
        for option, schema in chosen.items():
            yield f"{group}={option}: {summary(schema)}"
            yield from _keys(schema, f"{group}.")
    else:
        for option, schema in chosen.items():
            for line in _keys(schema, f"{group}.", key):
                having[line].append(option)
        if not having:
            text = "--help takes groups, options and keys of bbq train"
            raise ConfigError(f"{text}, got {shown(word)}")
        yield from (f"{line} ({', '.join(names)})" for line, names in having.items())


def _by_name(schema: type) -> dict[str, Field[Any]]:
    groups = {"name", *schemas()}
    return {item.name: item for item in fields(schema) if item.name not in groups}


def _keys(schema: type, prefix: str = "", key: str | None = None) -> Iterator[str]:
    """Yields a line for each key, or for one, with default, meaning and what is allowed."""
    for name, item in _by_name(schema).items():
        if key in (None, name):
            allowed = item.metadata["allowed"].text
            start = f"  {prefix}{name}={default(item)}"
            yield f"{start:<34} {item.metadata['meaning']}; {allowed}"


def summary(schema: type) -> str:
    """Returns the first paragraph of an option's docstring, as one line."""
    return " ".join((inspect.getdoc(schema) or "").split("\n\n")[0].split())


def default(item: Field[Any]) -> str:
    """Returns a key's default as YAML."""
    value = item.default if item.default_factory is MISSING else item.default_factory()
    return str(value) if isinstance(value, str) else json.dumps(value)
