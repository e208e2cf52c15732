"""A cinema small enough to look up records by hand: the folder ``cinema``."""

from dataclasses import replace
from pathlib import Path

from bbq_torchrl.domains import load_domain

from .dialogue import Dialogue, Setting, World

CINEMA = load_domain(Path(__file__).with_name("cinema"))
SLOTS = CINEMA.slots
GOAL = CINEMA.goals[0].constraints

ALMOST_ONE = 1 - 2**-24


def small_domain(*goals, records=CINEMA.records):
    """Returns the small cinema with these goals."""
    return replace(CINEMA, goals=goals, records=tuple(records))


def draws(**chosen):
    """Returns draws without errors; `agenda="city"` makes that draw choose the slot.

    A dict has uniforms of single slots, a number is the uniform of all slots.
    """
    result = {"goal": 0.0, "intent": ALMOST_ONE, "intent_act": 0.0, "offer": 0.0}
    names = ("constraint", "request", "agenda", "error", "error_kind", "error_slot", "error_value")
    for name in names:
        result[name] = [ALMOST_ONE if name == "error" else 0.0] * len(SLOTS)
    for name, choice in chosen.items():
        if isinstance(choice, str):
            choice = {choice: ALMOST_ONE}
        if isinstance(choice, dict):
            for slot, u in choice.items():
                result[name][SLOTS.index(slot)] = u
        elif isinstance(result[name], list):
            result[name] = [choice] * len(SLOTS)
        else:
            result[name] = choice
    return result


def start(goal, *, first=None, **setting):
    """Returns a dialogue about one goal in the small cinema, after the user's first act."""
    world = World(small_domain(goal), Setting(**setting))
    return Dialogue(world, draws(**(first or {})))


def say(dialogue, *actions, **chosen):
    """Plays agent acts, each with the same draws."""
    for name in actions:
        dialogue.turn(CINEMA.actions[CINEMA.action_index(name)], draws(**chosen))
