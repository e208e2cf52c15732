"""Blocks that show a file as it is: figures of results/, and files of the examples."""

from __future__ import annotations

import csv
import json
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.evaluation.results import read_result
from bbq_torchrl.shipped import PREFIX, SHIPPED, shipped_agents
from scripts.docs_blocks.markdown import table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["table_blocks"]

ROOT = Path(__file__).resolve().parents[2]
RESULTS, EXAMPLES = ROOT / "results", ROOT / "examples"
EXTENDING = ("ucb_policy", "ucb", "langevin", "visits", "chain")
QUALITY = (
    ("frame exactly right, free sentences", "frame", "≥ .85"),
    ("slot F1, free sentences", "slot_f1", "≥ .93"),
    ("act right, free sentences", "act", "≥ .95"),
    ("slot F1, templates of another hand", "other_hand_slot_f1", "≥ .97"),
    ("answered without asking again", "answered", "≥ .80"),
    ("right among the answered", "right_of_answered", "≥ .95"),
    ("calibration error", "calibration_error", "≤ .05"),
    ("frame exactly right, sentences written later", "held_out_frame", "≥ .85"),
    ("slot F1, sentences written later", "held_out_slot_f1", "≥ .93"),
    ("act right, sentences written later", "held_out_act", "≥ .95"),
    ("answered, sentences written later", "held_out_answered", "≥ .80"),
    ("right among the answered, sentences written later", "held_out_right_of_answered", "≥ .95"),
    ("calibration error, sentences written later", "held_out_calibration_error", "≤ .05"),
    ("slot F1 lost by typos in 10 % of the words", "typos_cost_slot_f1", "≤ .05"),
    ("slot F1 lost by lower case without marks", "lowered_cost_slot_f1", "≤ .01"),
    ("round trip, frame exactly right", "round_trip_frame", "≥ .97"),
    ("round trip, slot F1", "round_trip_slot_f1", ""),
    ("training, seconds of one core", "training_seconds", "≤ 60"),
    ("size, MB", "megabytes", "≤ 3"),
    ("milliseconds a sentence", "milliseconds_a_sentence", "≤ 5"),
)
"""How well the language layer understands: what, its key in results/language.json, the aim."""

# An example is a folder of scripts, no package.
sys.path.append(str(EXAMPLES / "deep_sea"))


def table_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks."""
    return {
        "adversary": _adversary,
        "deep_sea.results": _deep_sea,
        "deep_sea.trials": _deep_sea_trials,
        "language.quality": _quality,
        "language.voices": _voices,
        "language.ladder": _ladder,
        "shipped": _shipped,
        **{f"extending.{name}": partial(_extending, name) for name in EXTENDING},
    }


def _json(name: str) -> dict[str, Any]:
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))


def _adversary() -> str:
    """Returns what was done to runs, and what became of them."""
    found = _json("adversary.json")
    rows = [(*name.split(": ", 1), times) for name, times in found["outcomes"].items()]
    shown = table(("tried", "what came of it", "times"), rows, numbers=1)
    return f"{shown}\n\n```bash\nBBQ_RECORD=results/adversary.json {found['command']}\n```"


def _deep_sea() -> str:
    from deep_sea_results import AGENT_NAMES, read
    from deep_sea_results import table as results_table

    return results_table(read(), list(AGENT_NAMES))


def _deep_sea_trials() -> str:
    with (RESULTS / "deep_sea_trials.csv").open(newline="", encoding="utf-8") as file:
        head, *lines = csv.reader(file)
    return table(head, lines)


def _quality() -> str:
    measured = _json("language.json")
    rows = [(what, f"{measured[key]:.3g}", aim) for what, key, aim in QUALITY]
    return table(("", "measured", "aim"), rows)


def _voices() -> str:
    measured = _json("language.json")
    rows = [
        (voice, *(f"{figures[key]:.3f}" for key in ("frame", "slot_f1", "act")))
        for voice, figures in measured["voices"].items()
    ]
    return table(("voice", "frame", "slot F1", "act"), rows)


def _ladder() -> str:
    """Returns each policy's success on every rung from acts to text."""
    entries = json.loads((RESULTS / "ladder.json").read_text(encoding="utf-8"))
    rates: dict[str, dict[str, str]] = {}
    for entry in entries:
        result = entry["result"]
        rate = f"{result['success_rate']:.3f} ± {result['standard_error']:.3f}"
        rates.setdefault(entry["policy"], {})[entry["rung"]] = rate
    rungs = list(dict.fromkeys(entry["rung"] for entry in entries))
    rows = [
        (f"`{policy}`", *(found.get(rung, "–") for rung in rungs))
        for policy, found in rates.items()
    ]
    counts = sorted({entry["result"]["dialogues"] for entry in entries})
    played = " to ".join(f"{count:,}" for count in dict.fromkeys((counts[0], counts[-1])))
    shown = table(("policy", *rungs), rows, numbers=len(rungs))
    return f"{shown}\n\n± one standard error; {played} dialogues each."


def _shipped() -> str:
    """Returns the agents that come with the package, what made them, and what they reach."""
    rows = []
    for name in shipped_agents():
        result = read_result(SHIPPED / name)
        given = yaml.safe_load((SHIPPED / name / "overrides.yaml").read_text(encoding="utf-8"))
        command = f"`python train.py {shlex.join(given)}`"
        rate = f"{result.success_rate:.3f} ± {result.standard_error:.3f}"
        rows.append((f"`{PREFIX}{name}`", command, result.rounds, rate))
    return table(("name", "trained by", "rounds", "success"), rows, numbers=2)


def _extending(name: str) -> str:
    """Returns a file of the example package of options, so that the page shows what runs."""
    file = EXAMPLES / "extending" / "bbq_extending" / f"{name}.py"
    return f"```python\n{file.read_text(encoding='utf-8')}```"
