"""The oracle against dialogues worked out by hand: ``rules.txt`` has a rule a dialogue.

There stand what the user wants (``goal``: constraints, ``?``, requests), the draws of its first
turn (``first``) and the ``setting``; then the agent's acts with the draws of the turn, and,
indented, what must be so after them (:func:`seen`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from .draws import choose_index, choose_slot
from .small import GOAL, SLOTS, say, start

RULES = Path(__file__).with_name("rules.txt").read_text().strip().split("\n\n")


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.splitlines()[0][2:])
def test_the_oracle_plays_as_the_rules_say(rule):
    lines = [line for line in rule.splitlines() if not line.startswith("#")]
    head = dict(line.split(" ", 1) for line in lines if line[0] != " ")
    wants, _, asks = head["goal"].partition("?")
    setting = options(head.get("setting", ""))
    if "active" in setting:
        setting["active"] = setting["active"].split(",")
    wants = dict(pair.split("=") for pair in wants.split())
    dialogue = start(wants, tuple(asks.split()), first=options(head.get("first", "")), **setting)
    for line in lines:
        word, *rest = line.split(" ", 2)
        if word == "agent":
            say(dialogue, rest[0], **options("".join(rest[1:])))
        elif not word:
            found = seen(dialogue)
            for name, _, expected in (part.partition(": ") for part in line.strip().split("; ")):
                assert found[name] == expected, line


def test_a_choice_among_slots_falls_on_the_largest_number_and_on_the_first_of_equals():
    u = [0.9, 0.5, 0.5, 0.1]
    assert choose_slot({"b", "c", "d"}, u, ["a", "b", "c", "d"]) == "b"
    assert choose_slot({"c", "d"}, u, ["a", "b", "c", "d"]) == "c"
    assert [choose_index(u, 4) for u in (0.0, 0.24, 0.25, 0.99)] == [0, 0, 1, 3]


def test_the_features_of_a_state_by_hand():
    dialogue = start(GOAL, ("theater",), first={"constraint": "city"})
    say(dialogue, "request(numberofpeople)", "inform(date)")
    assert dialogue.tracker.agent_informs == {"date": "today"}
    # Rows: moviename, city, date, theater, genre, numberofpeople, ticket, taskcomplete.
    counts = [4, 3, 3, 2, 2, 0, 2, 2, 2]
    assert dialogue.features() == [
        *[1, 0, 0, 0, 0, 0, 0, 0, 0],  # the user's act: request
        *[0, 0, 0, 0, 0, 0, 0, 0],  # what the user informs
        *[0, 0, 0, 1, 0, 0, 0, 0],  # what the user requests: the theater again
        *[0, 1, 0, 0, 0, 0, 0, 0, 0],  # the agent's act: inform
        *[0, 0, 1, 0, 0, 0, 0, 0],  # what the agent informs
        *[0, 0, 0, 0, 0, 0, 0, 0],  # what the agent requests
        *[1, 1, 1, 0, 0, 1, 0, 0],  # filled
        *[0.5, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0],  # five acts so far
        *(float(count > 0) for count in counts),
        *(count / 100 for count in counts),
    ]
    assert len(dialogue.features()) == 2 * 9 + 7 * len(SLOTS) + 3 + 10


def test_a_slot_that_is_not_active_is_seen_nowhere():
    active = {"moviename", "city", "numberofpeople", "ticket", "taskcomplete"}
    goal = GOAL | {"date": "today"}
    dialogue = start(goal, ("theater",), first={"constraint": "date"}, active=active)
    counts = dialogue.features()[-9:]
    assert [round(100 * count) for count in counts] == [4, 4, 0, 0, 0, 4, 4, 4, 4]
    names = [str(dialogue.world.domain.actions[i]) for i in dialogue.world.legal_actions()]
    assert "request(city)" in names
    assert "greeting" in names
    assert not [name for name in names if "date" in name or "theater" in name or "genre" in name]


def options(text: str) -> dict[str, Any]:
    """Returns ``a=1 b.city=0.5`` as ``{"a": 1, "b": {"city": 0.5}}``."""
    found: dict[str, Any] = {}
    for pair in text.split():
        path, value = pair.split("=")
        name, _, slot = path.partition(".")
        if slot:
            found.setdefault(name, {})[slot] = yaml.safe_load(value)
        else:
            found[name] = yaml.safe_load(value)
    return found


def seen(dialogue) -> dict[str, str]:
    """Returns what there is to see of a dialogue, as text."""
    user, tracker = dialogue.user, dialogue.tracker
    return {
        "user": f"{user.act}({values(user.informs)})",
        "pending": slots(user.pending),
        "agenda": slots(user.agenda),
        "history": values(user.history),
        "met": str(user.constraints_met),
        "faults": ", ".join(user.faults()) or "none",
        "heard": tracker.heard_act,
        "asked": slots(tracker.user_requests),
        "agent": f"{tracker.agent_act}({values(tracker.agent_informs)})",
        "held": values(tracker.held),
        "rows": str(len(tracker.shelf.matching(tracker.held))),
        "turn": str(dialogue.turn_count),
        "end": "success" if dialogue.success else "failure" if dialogue.done else "not yet",
        "reward": str(dialogue.reward),
    }


def slots(chosen) -> str:
    return " ".join(slot for slot in SLOTS if slot in chosen) or "none"


def values(held) -> str:
    return ", ".join(f"{slot}={held[slot]}" for slot in SLOTS if slot in held)
