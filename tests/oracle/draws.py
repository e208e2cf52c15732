"""How a uniform number in [0, 1) becomes a choice, and a source of such numbers."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from random import Random

Draws = Mapping[str, Any]

RESET_SLOT_DRAWS = ("constraint", "request")
TURN_SLOT_DRAWS = ("agenda", "error", "error_kind", "error_slot", "error_value")
TURN_DRAWS = ("intent", "intent_act", "offer")


def choose_index(u: float, count: int) -> int:
    """Returns which of `count` things the uniform `u` stands for."""
    return math.floor(u * count)


def choose_slot(candidates: Collection[str], u: Sequence[float], slots: Sequence[str]) -> str:
    """Returns the candidate with the largest uniform, the first of them in slot order on a tie."""
    best = None
    for number, slot in enumerate(slots):
        if slot in candidates and (best is None or u[number] > u[slots.index(best)]):
            best = slot
    if best is None:
        raise ValueError("there is no slot to choose from")
    return best


def reset_draws(random: Random, n_slots: int) -> dict[str, Any]:
    """Returns the random numbers that one dialogue's start uses."""
    draws: dict[str, Any] = {"goal": random.random()}
    for name in RESET_SLOT_DRAWS:
        draws[name] = [random.random() for _ in range(n_slots)]
    return draws


def turn_draws(random: Random, n_slots: int) -> dict[str, Any]:
    """Returns the random numbers that one turn uses."""
    draws: dict[str, Any] = {name: random.random() for name in TURN_DRAWS}
    for name in TURN_SLOT_DRAWS:
        draws[name] = [random.random() for _ in range(n_slots)]
    return draws
