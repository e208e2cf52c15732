"""The checks that every domain passes on construction."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from bbq_torchrl.domains.values import DONT_CARE, RESERVED_TEXT, fold

if TYPE_CHECKING:
    from collections.abc import Iterable

    from bbq_torchrl.domains.domain import Domain

__all__ = ["REQUIRED_ACTS", "check_domain"]

REQUIRED_ACTS = (
    "request",
    "inform",
    "confirm_question",
    "confirm_answer",
    "greeting",
    "closing",
    "multiple_choice",
    "thanks",
    "deny",
)
"""The acts whose meaning the user simulator knows; a domain may add others."""

_ACTION_KINDS = ("act", "request", "inform", "multiple_choice")


def check_domain(domain: Domain) -> None:
    """Checks that names, special slots, actions, policies and data fit together.

    Raises:
        ValueError: naming the key, the value and what is allowed.
    """
    _check_names(domain)
    _check_special_slots(domain)
    _check_actions(domain)
    _check_policies(domain)
    _check_numbers(domain)
    _check_records(domain)
    _check_goals(domain)
    _check_error_values(domain)


def _check_names(domain: Domain) -> None:
    if not domain.name:
        raise ValueError("name of a domain must not be empty")
    for key in ("acts", "slots", "essential", "extension_order", "free_slots"):
        names: tuple[str, ...] = getattr(domain, key)
        if repeated := _repeated(names):
            raise ValueError(f"{key} must be distinct, got {repeated} more than once")
    for act in domain.acts:
        if not act.isidentifier():
            raise ValueError(f"acts must be identifiers, got {act!r}")
    for slot in domain.slots:
        if not re.fullmatch(r"\w+", slot):
            raise ValueError(f"slots must consist of letters, digits and underscores, got {slot!r}")
    if missing := [act for act in REQUIRED_ACTS if act not in domain.acts]:
        raise ValueError(f"acts must contain {list(REQUIRED_ACTS)}, {missing} are missing")
    for key in ("essential", "extension_order", "free_slots"):
        _check_slots(domain, key, getattr(domain, key))
    if both := [slot for slot in domain.extension_order if slot in domain.essential]:
        raise ValueError(f"extension_order must not contain essential slots, got {both} in both")


def _check_slots(domain: Domain, key: str, slots: Iterable[str]) -> None:
    for slot in slots:
        if slot not in domain.slots:
            raise ValueError(
                f"{key} names the unknown slot {slot!r}; the slots are {list(domain.slots)}"
            )


def _check_special_slots(domain: Domain) -> None:
    _check_slots(domain, "ticket_slot", [domain.ticket_slot])
    _check_slots(domain, "complete_slot", [domain.complete_slot])
    if domain.ticket_slot == domain.complete_slot:
        raise ValueError(
            f"ticket_slot and complete_slot must differ, got {domain.ticket_slot!r} for both"
        )
    for key, slot in (("ticket_slot", domain.ticket_slot), ("complete_slot", domain.complete_slot)):
        for group in ("essential", "free_slots"):
            if slot not in getattr(domain, group):
                raise ValueError(
                    f"{key} must be among {group}, {slot!r} is not in "
                    f"{list(getattr(domain, group))}"
                )
    if domain.opening_slot is not None:
        _check_slots(domain, "opening_slot", [domain.opening_slot])
        if domain.opening_slot in domain.special_slots:
            raise ValueError(
                f"opening_slot must not be the ticket or the complete slot, "
                f"got {domain.opening_slot!r}"
            )


def _check_actions(domain: Domain) -> None:
    if repeated := _repeated(domain.action_names):
        raise ValueError(f"actions must be distinct, got {repeated} more than once")
    for action in domain.actions:
        if action.act not in domain.acts:
            raise ValueError(
                f"action {action} has the unknown act {action.act!r}; the acts are "
                f"{list(domain.acts)}"
            )
        if action.slot is not None:
            _check_slots(domain, f"action {action}", [action.slot])
        elif action.act in ("request", "inform", "multiple_choice"):
            raise ValueError(f"action {action} needs a slot, written {action.act}(slot)")
        if action.kind in ("request", "multiple_choice") and action.slot in domain.special_slots:
            raise ValueError(f"action {action} makes no sense: no user constrains {action.slot}")
    kinds = [_ACTION_KINDS.index(action.kind) for action in domain.actions]
    if kinds != sorted(kinds):
        raise ValueError(
            f"actions must be slotless acts, then requests, informs and multiple choices, "
            f"got {list(domain.action_names)}"
        )
    offer = f"inform({domain.complete_slot})"
    if offer not in domain.action_names:
        raise ValueError(f"actions must contain {offer}: without it nothing can be booked")
    if not {"thanks", "closing"} & set(domain.action_names):
        raise ValueError("actions must contain thanks or closing: no dialogue succeeds without")


def _check_policies(domain: Domain) -> None:
    for name, policy in domain.policies.items():
        key = f"policies.{name}"
        if policy.kind not in ("script", "careful"):
            raise ValueError(f"{key} must be of kind 'script' or 'careful', got {policy.kind!r}")
        if not policy.steps:
            raise ValueError(f"{key} must have at least one step, got none")
        needed = policy.steps
        if policy.kind == "careful":
            _check_slots(domain, key, policy.steps)
            ending = (f"inform({domain.complete_slot})", "thanks")
            needed = (*(f"request({slot})" for slot in policy.steps), *ending)
        for action in needed:
            if action not in domain.action_names:
                raise ValueError(
                    f"{key} needs the action {action!r}, which is not among "
                    f"{list(domain.action_names)}"
                )


def _check_numbers(domain: Domain) -> None:
    if domain.turn_width < 1:
        raise ValueError(f"turn_width must be at least 1, got {domain.turn_width}")
    if not 0.0 <= domain.reference_slot_error_prob <= 1.0:
        raise ValueError(
            f"reference_slot_error_prob must be between 0 and 1, "
            f"got {domain.reference_slot_error_prob}"
        )


def _check_value(
    domain: Domain, where: str, slot: str, value: object, *, reserved: tuple[int, ...] = ()
) -> None:
    _check_slots(domain, where, [slot])
    if not isinstance(value, str) or not value.strip() or value.splitlines() != [value]:
        raise ValueError(f"{where}: {slot} must have one line of text, not blank, got {value!r}")
    taken = {fold(text) for key, text in RESERVED_TEXT.items() if key not in reserved}
    if fold(value) in taken:
        raise ValueError(f"{where}: {slot} must not have the reserved value {value!r}")


def _check_records(domain: Domain) -> None:
    if not domain.records:
        raise ValueError(f"the knowledge base of domain {domain.name!r} is empty")
    for row, record in enumerate(domain.records):
        if not record:
            raise ValueError(f"record {row} must have at least one value, got none")
        for slot, value in record.items():
            _check_value(domain, f"record {row}", slot, value)
            if slot in domain.special_slots:
                raise ValueError(f"record {row} must not hold the special slot {slot!r}")


def _check_goals(domain: Domain) -> None:
    if not domain.goals:
        raise ValueError(f"domain {domain.name!r} has no goals")
    for number, goal in enumerate(domain.goals):
        where = f"goal {number}"
        if repeated := _repeated(goal.requests):
            raise ValueError(f"{where} must request a slot once, got {repeated} again")
        _check_slots(domain, where, goal.requests)
        for slot, value in goal.constraints.items():
            _check_value(domain, where, slot, value, reserved=(DONT_CARE,))
        for slot in (*goal.constraints, *goal.requests):
            if slot in domain.special_slots:
                raise ValueError(
                    f"{where} must not name {slot!r}: every goal requests the ticket as it is"
                )
        if both := [slot for slot in goal.requests if slot in goal.constraints]:
            raise ValueError(f"{where} must not constrain and request the same slots {both}")


def _check_error_values(domain: Domain) -> None:
    for slot, values in domain.error_values.items():
        if not values:
            raise ValueError(f"error_values.{slot} must list at least one value, got none")
        for value in values:
            _check_value(domain, "error_values", slot, value)
        if slot in domain.special_slots:
            raise ValueError(f"error_values must not list the special slot {slot!r}")


def _repeated(names: Iterable[str]) -> list[str]:
    """Returns the names that occur more than once, in order of their second appearance."""
    seen: set[str] = set()
    repeated: list[str] = []
    for name in names:
        if name in seen and name not in repeated:
            repeated.append(name)
        seen.add(name)
    return repeated
