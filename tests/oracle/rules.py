"""Dialogues worked out by hand: ``rules.txt`` has a dialogue for each rule.

A dialogue starts with the user's ``goal`` (constraints, ``?``, requests), the draws of the first
turn (``first``) and the ``setting``. The agent's acts follow with the draws of their turns and,
indented, the expected observations (:func:`seen`).
"""

from pathlib import Path

import yaml

from bbq_torchrl.domains import Goal

from .small import SLOTS, say, start

RULES = Path(__file__).with_name("rules.txt").read_text().strip().split("\n\n")


def played(rule):
    """Plays a dialogue of the file. Yields it at each expectation, together with that."""
    lines = [line for line in rule.splitlines() if not line.startswith("#")]
    head = dict(line.split(" ", 1) for line in lines if line[0] != " ")
    wants, _, asks = head["goal"].partition("?")
    constraints = dict(pair.split("=") for pair in wants.split())
    setting = options(head.get("setting", ""))
    if "active" in setting:
        setting["active"] = tuple(setting["active"].split(","))
    first = options(head.get("first", ""))
    dialogue = start(Goal(constraints, tuple(asks.split())), first=first, **setting)
    for line in lines:
        word, *rest = line.split(" ", 2)
        if word == "agent":
            say(dialogue, rest[0], **options("".join(rest[1:])))
        elif not word:
            yield dialogue, dict(part.split(": ") for part in line.strip().split("; "))


def rules_at_work():
    """Returns the names of all rules that apply in the dialogues of the file."""
    dialogues = [[*played(rule)][-1][0] for rule in RULES]
    return {name for dialogue in dialogues for name in dialogue.world.fired}


def options(text):
    """Returns ``a=1 b.city=0.5`` as ``{"a": 1, "b": {"city": 0.5}}``."""
    found = {}
    for pair in text.split():
        path, value = pair.split("=")
        name, _, slot = path.partition(".")
        if slot:
            found.setdefault(name, {})[slot] = yaml.safe_load(value)
        else:
            found[name] = yaml.safe_load(value)
    return found


def seen(dialogue):
    """Returns the observable state of a dialogue as text."""
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
        "rows": str(len(tracker.records.matching(tracker.held))),
        "turn": str(dialogue.turn_count),
        "end": "success" if dialogue.success else "failure" if dialogue.done else "not yet",
        "reward": str(dialogue.reward),
    }


def slots(chosen):
    return " ".join(slot for slot in SLOTS if slot in chosen) or "none"


def values(held):
    return ", ".join(f"{slot}={held[slot]}" for slot in SLOTS if slot in held)
