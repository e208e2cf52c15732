"""The reader of ``domain.yaml``: all of a domain but its records, goals and values."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.checks import INTEGER, NUMBER, TEXT, Allowed, check
from bbq_torchrl.domains.faults import Source
from bbq_torchrl.domains.parts import ACTION_KINDS, Action, ScriptedPolicySpec
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
