"""Dialogue state, policy, control, success and beliefs: the parts that chat and study share."""

from __future__ import annotations

RULE_NAMES = (
    "yes_ends",
    "answers_first",
    "no_asking_back",
    "news",
    "no_repeat",
    "take_back",
    "confirm",
    "book",
    "names",
    "farewell",
    "check",
    "aside",
)
"""The rules of :mod:`~bbq_torchrl.people.dialogue.control`, here where no torch is needed."""
