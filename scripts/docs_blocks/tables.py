"""Blocks that show a file as it is: figures of results/, and files of the examples."""

from __future__ import annotations

import math
import re
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

import yaml

from bbq_torchrl.evaluation.results import read_result
from bbq_torchrl.evaluation.statistics import summarize
from bbq_torchrl.shipped import PREFIX, SHIPPED, shipped_agents
from scripts.docs_blocks.common import (
    FIGURES,
    RESULTS,
    ROOT,
    block,
    code,
    read_csv,
    read_json,
    table,
)

__all__ = ["copy_figures", "success_rate"]

EXAMPLES = ROOT / "examples"

# An example is a folder of scripts, no package.
sys.path.append(str(EXAMPLES / "deep_sea"))


@block("adversary")
def _adversary() -> str:
    """Returns what was done to runs, and what became of them."""
    found = read_json("adversary.json")
    rows = [(*name.split(": ", 1), times) for name, times in found["outcomes"].items()]
    shown = table(("tried", "what came of it", "times"), rows, numbers=1)
    return f"{shown}\n\n```bash\nBBQ_RECORD=results/adversary.json {found['command']}\n```"


@block("deep_sea.results")
def _deep_sea() -> str:
    from deep_sea_results import AGENT_NAMES, read
    from deep_sea_results import table as results_table

    return results_table(read(), list(AGENT_NAMES))


@block("deep_sea.trials")
def _deep_sea_trials() -> str:
    lines = read_csv("deep_sea_trials.csv")
    return table(tuple(lines[0]), [tuple(line.values()) for line in lines])


@block("language.quality")
def _quality() -> str:
    """Returns how well the language layer understands, beside what it was to reach."""
    measured = read_json("language.json")
    sets = [measured[name] for name in ("free", "second_held_out", "third_held_out")]
    lines = read_csv("language_aims.csv")
    understood = [
        (line["what"], *(f"{one[line['key']]:.3f}" for one in sets), line["aim"])
        for line in lines
        if line["key"] in sets[0]
    ]
    rest = [
        (line["what"], f"{measured[line['key']]:.3g}", line["aim"])
        for line in lines
        if line["key"] in measured
    ]
    names = ("first", "second", "third")
    head = ("", *(f"{n} {one['sentences']}" for n, one in zip(names, sets, strict=True)), "aim")
    return f"{table(head, understood)}\n\n{table(('', 'measured', 'aim'), rest)}"


@block("language.voices")
def _voices() -> str:
    rows = [
        (voice, *(f"{figures[key]:.3f}" for key in ("frame", "slot_f1", "act")))
        for voice, figures in read_json("language.json")["voices"].items()
    ]
    return table(("voice", "frame", "slot F1", "act"), rows)


@block("language.ladder")
def _ladder() -> str:
    """Returns each policy's success on every rung from acts to text."""
    entries = [entry for entry in read_json("ladder.json") if entry["rung"] in _LADDER]
    policies = dict.fromkeys(entry["policy"] for entry in entries)
    rates = {(entry["policy"], entry["rung"]): _rate(entry["result"], 3) for entry in entries}
    rows = [(code(name), *(rates.get((name, rung), "–") for rung in _LADDER)) for name in policies]
    counts = {entry["result"]["dialogues"] for entry in entries}
    played = " to ".join(f"{count:,}" for count in sorted({min(counts), max(counts)}))
    shown = table(("policy", *_LADDER), rows, numbers=len(_LADDER))
    return f"{shown}\n\n± one standard error; {played} dialogues each."


_LADDER = ("no errors", "reference", "measured", "text, never asking", "text")
_ASKING = {"text, never asking": "never", "text": "below .7", "text, cautious": "below .9"}
"""Rungs that differ in when the system asks again."""


@block("language.cautious")
def _cautious() -> str:
    """Returns what each policy reaches in sentences by when the system asks again."""
    entries = {(entry["policy"], entry["rung"]): entry for entry in read_json("ladder.json")}
    rows = []
    for policy in dict.fromkeys(policy for policy, _ in entries):
        for rung, asks in _ASKING.items():
            if entry := entries.get((policy, rung)):
                result = entry["result"]
                rate, reward, turns = (result[k] for k in ("success_rate", "reward", "turns"))
                # Each turn of the agent but the last costs 1, and so does each time it asks again.
                again = 40 * rate - 10 * (1 - rate) - (turns - 1) - reward
                shown = (_rate(result, 3), f"{reward:.1f}", f"{turns:.1f}", f"{abs(again):.2f}")
                rows.append((code(policy), asks, *shown, f"{result['dialogues']:,}"))
    head = ("policy", "asks again", "success", "reward", "turns", "asked again", "dialogues")
    return table(head, rows, numbers=5)


@block("language.trained")
def _trained() -> str:
    """Returns what training on counted errors gives on each rung, by pairs of replicas."""
    found = {
        (Path(entry["policy"]).name, entry["rung"]): entry["result"]["success_rate_per_replica"]
        for entry in read_json("trained_on_errors.json")
    }
    rows = []
    for rung in dict.fromkeys(rung for _, rung in found):
        own, other = found["bbqn_measured", rung], found["bbqn_reference", rung]
        gain = [a - b for a, b in zip(own, other, strict=True)]
        rows.append(
            (rung, *(summarize(rates).t for rates in (own, other)), f"{summarize(gain).t:+.3f}")
        )
    head = ("played with", "trained with counted errors", "with the reference's", "difference")
    return table(head, rows, numbers=3)


@block("shipped")
def _shipped() -> str:
    """Returns the agents that come with the package, what made them, and what they reach."""
    rows = []
    for name in shipped_agents():
        result = read_result(SHIPPED / name)
        given = yaml.safe_load((SHIPPED / name / "overrides.yaml").read_text(encoding="utf-8"))
        command = code(f"python train.py {shlex.join(given)}")
        rate = f"{result.success_rate:.3f} ± {result.standard_error:.3f}"
        rows.append((code(f"{PREFIX}{name}"), command, result.rounds, rate))
    return table(("name", "trained by", "rounds", "success"), rows, numbers=2)


def success_rate(corpus: str, setting: str, policy: str) -> float | None:
    """Returns what was measured of a policy that does not learn; None if it was not."""
    result = _measured().get((corpus, setting, policy))
    return result and result["success_rate"]


def _measured() -> dict[tuple[str, str, str], dict[str, Any]]:
    return {
        (entry["corpus"], entry["setting"], entry["policy"]): entry["result"]
        for entry in read_json("policies.json")
    }


@block("policies.reference")
def _reference() -> str:
    """Returns every policy in the reference setting of both corpora, with the commands."""
    entries = [entry for entry in read_json("policies.json") if entry["setting"] == "reference"]
    rows = [
        (
            code(entry["corpus"]),
            code(entry["policy"]) + (", privileged" if "privileged" in entry["result"] else ""),
            entry["result"]["dialogues"],
            _rate(entry["result"]),
            f"{entry['result']['reward']:.2f}",
            f"{entry['result']['turns']:.2f}",
        )
        for entry in entries
    ]
    head = ("domain", "policy", "dialogues", "success rate", "reward", "turns")
    commands = "\n".join(entry["command"] for entry in entries)
    return (
        f"{table(head, rows, numbers=4)}\n\n(± one standard error; written by "
        "`python scripts/measure_policies.py --miulab <folder>`, which runs)\n\n"
        f"```bash\n{commands}\n```"
    )


@block("policies.comparison")
def _comparison() -> str:
    """Returns our simulator beside the public one on the public corpus."""
    measured, rows = _measured(), []
    for line in read_csv("public_simulator.csv"):
        rate, error = float(line["success_rate"]), float(line["standard_error"])
        ours = measured["miulab", line["setting"], line["policy"]]
        spread = math.hypot(error, ours["standard_error"])
        difference = f"{(ours['success_rate'] - rate) / spread:+.1f}"
        theirs = f"{rate:.3f} ± {error:.3f}"
        rows.append((line["setting"], code(line["policy"]), theirs, _rate(ours), difference))
    head = ("goals, slot errors", "policy", "public simulator", "ours", "difference / its error")
    return table(head, rows, numbers=3)


def _rate(result: dict[str, Any], digits: int = 4) -> str:
    return f"{result['success_rate']:.{digits}f} ± {result['standard_error']:.{digits}f}"


def _extending(name: str) -> str:
    """Returns a file of the example package of options, so that the page shows what runs."""
    file = EXAMPLES / "extending" / "bbq_extending" / f"{name}.py"
    return f"```python\n{file.read_text(encoding='utf-8')}```"


for _name in ("ucb_policy", "ucb", "langevin", "visits", "chain"):
    block(f"extending.{_name}", _name)(_extending)


@block("study.uncertainty")
def _uncertainty() -> str:
    """Returns the table of how well uncertainty warns, of the study of several kinds of it."""
    text = (RESULTS / "study" / "uncertainty" / "report.md").read_text(encoding="utf-8")
    return text.split("\n## Does uncertainty predict failure?")[1].split("\n## ")[0]


@block("study.simulated")
def _simulated() -> str:
    """Returns the report of the study with simulated users, a level deeper."""
    text = (RESULTS / "study" / "report.md").read_text(encoding="utf-8")
    text = re.sub(r"\]\((\w+)\.png\)", r"](figures/study_simulated_\1.png)", text)
    return re.sub("^#", "###", text, count=1).replace("\n## ", "\n#### ")


def copy_figures() -> list[Path]:
    """Copies that report's figures to the documentation's; returns the files."""
    return [
        shutil.copyfile(RESULTS / "study" / f"{name}.png", FIGURES / f"study_simulated_{name}.png")
        for name in ("success", "ratings")
    ]
