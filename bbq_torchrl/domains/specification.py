"""Reads ``domain.yaml``: all of a domain but its records, goals and values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.domains.domain import Action, ScriptedPolicySpec

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["SPECIFICATION_FILE", "read_specification"]

SPECIFICATION_FILE = "domain.yaml"

_NAME_LISTS = ("acts", "slots", "essential", "extension_order", "free_slots")
_TEXTS = ("name", "ticket_slot", "complete_slot")
_ACTION_KINDS = ("act", "request", "inform", "multiple_choice")
_KEYS = (
    *_NAME_LISTS,
    *_TEXTS,
    "actions",
    "opening_slot",
    "turn_width",
    "policies",
    "reference_slot_error_prob",
)


class _UniqueKeyLoader(yaml.SafeLoader):
    """A safe loader that refuses a key given twice, where YAML would let the last one win."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep=True)
        if len(mapping) != len(node.value):
            keys = [self.construct_object(key, deep=True) for key, _ in node.value]
            twice = sorted({str(key) for key in keys if keys.count(key) > 1})
            raise ValueError(f"keys must be given once, got {twice} again")
        return mapping


def read_specification(path: Path) -> dict[str, Any]:
    """Returns the fields of a :class:`~bbq_torchrl.domains.Domain` that ``domain.yaml`` gives.

    They are all but ``records``, ``goals`` and ``error_values``. Only their form is checked here;
    whether they fit together is checked by ``Domain``.

    Args:
        path: the file.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is no YAML mapping, lacks a key, or has an unknown key or a wrong type.
    """
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), Loader=_UniqueKeyLoader)
        return _fields(content)
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not valid YAML: {error}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _fields(content: object) -> dict[str, Any]:
    specification = _mapping("the file", content)
    _check_keys("the file", specification, _KEYS, optional=("opening_slot",))
    fields: dict[str, Any] = {key: _names(key, specification[key]) for key in _NAME_LISTS}
    fields |= {key: _text(key, specification[key]) for key in _TEXTS}
    opening = specification.get("opening_slot")
    fields["opening_slot"] = None if opening is None else _text("opening_slot", opening)
    fields["actions"] = _actions(specification["actions"])
    fields["policies"] = _policies(specification["policies"])
    turn_width = specification["turn_width"]
    if not isinstance(turn_width, int) or isinstance(turn_width, bool):
        raise ValueError(f"turn_width must be an integer, got {turn_width!r}")
    probability = specification["reference_slot_error_prob"]
    if not isinstance(probability, (int, float)) or isinstance(probability, bool):
        raise ValueError(f"reference_slot_error_prob must be a number, got {probability!r}")
    return fields | {"turn_width": turn_width, "reference_slot_error_prob": float(probability)}


def _actions(content: object) -> tuple[Action, ...]:
    actions = _mapping("actions", content)
    _check_keys("actions", actions, _ACTION_KINDS, optional=("multiple_choice",))
    return tuple(
        Action("act", name) if kind == "act" else Action(kind, kind, name)  # type: ignore[arg-type]
        for kind in _ACTION_KINDS
        for name in _names(f"actions.{kind}", actions.get(kind, []))
    )


def _policies(content: object) -> dict[str, ScriptedPolicySpec]:
    policies = {}
    for name, entry in _mapping("policies", content).items():
        key = f"policies.{name}"
        policy = _mapping(key, entry)
        _check_keys(key, policy, ("kind", "steps"))
        policies[name] = ScriptedPolicySpec(policy["kind"], _names(f"{key}.steps", policy["steps"]))
    return policies


def _mapping(key: str, content: object) -> dict[str, Any]:
    if not isinstance(content, dict) or not all(isinstance(name, str) for name in content):
        raise ValueError(f"{key} must be a mapping with names as keys, got {content!r}")
    return content


def _check_keys(
    where: str, mapping: dict[str, Any], allowed: tuple[str, ...], optional: tuple[str, ...] = ()
) -> None:
    if unknown := [key for key in mapping if key not in allowed]:
        raise ValueError(f"{where} has the unknown keys {unknown}; allowed are {list(allowed)}")
    if missing := [key for key in allowed if key not in mapping and key not in optional]:
        raise ValueError(f"{where} lacks the keys {missing}")


def _text(key: str, content: object) -> str:
    if not isinstance(content, str):
        raise ValueError(f"{key} must be a text, got {content!r}")
    return content


def _names(key: str, content: object) -> tuple[str, ...]:
    if not isinstance(content, list):
        raise ValueError(f"{key} must be a list of names, got {content!r}")
    return tuple(_text(f"every name in {key}", name) for name in content)
