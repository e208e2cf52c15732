"""Measures agents on the ladder from acts to text, and writes results/ladder.json.

Every agent is played without errors, with the reference errors, with those counted in sentences,
and in sentences, where the system asks again as it does in a chat, never, or cautiously. These are
the scripted policies ``rule`` and ``careful`` and the shipped agents of the full domain.
Commands and answers are kept; ``scripts/write_docs.py`` tabulates them.

    python scripts/measure_ladder.py                         everything, 10,000 dialogues each
    python scripts/measure_ladder.py --rung text measured    these rungs alone; the others stay
    python scripts/measure_ladder.py --dialogues 2500        fewer
    python scripts/measure_ladder.py --policy runs/a runs/b --file results/own.json
                                                             runs of your own, into another file
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from bbq_torchrl.cli.evaluate import composed, evaluation

FILE = Path(__file__).resolve().parent.parent / "results" / "ladder.json"

POLICIES = ("rule", "careful", "shipped:bbqn_map", "shipped:dqn")
"""The agents measured."""

RUNGS = {
    "no errors": "env.errors=drawn env.slot_error_prob=0",
    "reference": "env.errors=drawn",
    "measured": "env.errors=measured",
    "text": "env.errors=drawn env.level=text",
    "text, never asking": "env.errors=drawn env.level=text env.ask_below=0",
    "text, cautious": "env.errors=drawn env.level=text env.ask_below=.9",
}
"""Rung -> its command-line arguments, easiest first."""


def measure(policy: str, rung: str, dialogues: int) -> dict[str, Any]:
    """Returns a policy's result on a rung, with the command."""
    arguments = f"policy={policy} {RUNGS[rung]} dialogues={dialogues}".split()
    result = evaluation(composed(arguments))
    del result["turns_per_second"]  # of the machine, not of the agent
    command = f"bbq evaluate {' '.join(arguments)}"
    return {"policy": policy, "rung": rung, "command": command, "result": result}


def main() -> None:
    """Measures the selected entries, and keeps the other ones of the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", nargs="+", default=POLICIES, help="these alone")
    parser.add_argument("--rung", nargs="+", choices=RUNGS, help="these rungs alone")
    parser.add_argument("--dialogues", type=int, default=10_000, help="of each measurement")
    parser.add_argument("--file", type=Path, default=FILE, help="what is written")
    given = parser.parse_args()
    before = json.loads(given.file.read_text(encoding="utf-8")) if given.file.is_file() else []
    known = {(entry["policy"], entry["rung"]): entry for entry in before}
    policies = dict.fromkeys([*(policy for policy, _ in known), *given.policy])
    order = [(policy, rung) for policy in policies for rung in RUNGS]
    for policy, rung in order:
        if policy in given.policy and rung in (given.rung or RUNGS):
            known[policy, rung] = measure(policy, rung, given.dialogues)
            sys.stdout.write(f"{policy}, {rung}: {known[policy, rung]['result']}\n")
            entries = [known[item] for item in order if item in known]
            given.file.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
