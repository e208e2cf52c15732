"""Tables of measurements, from CSV and JSON files in results/."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs.folders import PREFIX, SHIPPED, shipped_agents
from bbq_torchrl.utils.statistics import estimate
from scripts.docs_blocks.common import (
    block,
    code,
    command,
    paired,
    pivot,
    read_csv,
    read_json,
    table,
)


def _rate(result: dict[str, Any], digits: int = 3) -> str:
    return f"{result['success_rate']:.{digits}f} ± {result['standard_error']:.{digits}f}"


@block("adversary")
def _adversary() -> str:
    """Returns the disturbances of runs, and their outcomes."""
    found = read_json("adversary.json")
    rows = [(*name.split(": ", 1), times) for name, times in found["outcomes"].items()]
    shown = table(("tried", "what came of it", "times"), rows, numbers=1)
    return f"{shown}\n\n```bash\nBBQ_RECORD=results/adversary.json {found['command']}\n```"


@block("parts.cartpole")
def _cartpole() -> str:
    """Returns the return of each seed in the loop of docs/parts.md, a line for each agent."""
    names = {
        "bbqn": "BBQN",
        "bbqn_episode": "BBQN, a draw an episode",
        "bbqn_paper_start": "BBQN, the paper's start",
        "dqn": "DQN",
    }
    found = read_csv("cartpole.csv")
    cells = {(names[row["agent"]], f"seed {row['seed']}"): row["return"] for row in found}
    command = "python examples/cartpole_bbqn.py --agent bbqn --seed 0 --file results/cartpole.csv"
    return f"{pivot('return', cells)}\n\n```bash\n{command}\n```"


@block("language.quality")
def _quality() -> str:
    """Returns the accuracy of the language layer, next to its targets."""
    found = read_json("language.json")
    sets = {"first": "free", "second": "second_held_out", "third": "third_held_out"}
    sets["strangers'"] = "strangers"
    columns = {f"{name} {found[key]['sentences']}": found[key] for name, key in sets.items()}
    columns["beside them"] = found
    cells = {}
    for line in read_csv("language_aims.csv"):
        for column, figures in columns.items():
            value = figures.get(line["key"])
            cells[line["what"], column] = "–" if value is None else f"{value:#.3g}"
        cells[line["what"], "aim"] = line["aim"] or "–"
    return pivot("", cells)


@block("language.limits")
def _limits() -> str:
    """Returns how the nlu owns up to what it does not understand."""
    cells, found = {}, read_json("limits.json")
    for row in read_csv("limits_aims.csv"):
        cells[row["what"], "measured"] = f"{found[row['set']][row['key']]:.3g}"
        cells[row["what"], "aim"] = row["aim"] or "–"
    return pivot("", cells)


@block("language.ladder")
def _ladder() -> str:
    """Returns each policy's success on every rung from acts to text."""
    entries = read_json("ladder.json")
    counts = sorted({entry["result"]["dialogues"] for entry in entries})
    played = " or ".join(f"{count:,}" for count in counts)
    cells = {(code(item["policy"]), item["rung"]): _rate(item["result"]) for item in entries}
    return f"{pivot('policy', cells)}\n\n± one standard error; {played} dialogues each."


@block("language.trained")
def _trained() -> str:
    """Returns the effect of training on measured errors on each rung, by pairs of replicas."""
    rates: dict[str, dict[str, list[float]]] = {}
    for entry in read_json("trained_on_errors.json"):
        of_rung = rates.setdefault(entry["rung"], {})
        of_rung[Path(entry["policy"]).name] = entry["result"]["success_rate_per_replica"]
    rows = [
        (rung, estimate(own), estimate(other), paired(own, other))
        for rung, of in rates.items()
        for own, other in [(of["bbqn_measured"], of["bbqn_reference"])]
    ]
    head = ("played with", "trained with counted errors", "with the reference's", "difference")
    return table(head, rows, numbers=3)


@block("shipped")
def _shipped() -> str:
    """Returns the shipped agents, their commands and their success."""
    rows = []
    for name in shipped_agents():
        one = read_result(SHIPPED / name)
        overrides = yaml.safe_load((SHIPPED / name / "overrides.yaml").read_text(encoding="utf-8"))
        shown = (code(f"{PREFIX}{name}"), code(command(overrides)), one.code, one.rounds)
        rows.append((*shown, _rate(vars(one))))
    return table(("name", "trained by", "at commit", "rounds", "success"), rows, numbers=2)


def measured() -> dict[tuple[str, str, str], dict[str, Any]]:
    """Returns the results of policies that do not learn: (corpus, setting, policy) -> figures."""
    return {
        (entry["corpus"], entry["setting"], entry["policy"]): entry["result"]
        for entry in read_json("policies.json")
    }


@block("policies.reference")
def _reference() -> str:
    """Returns every policy's success in the reference setting of both corpora."""
    return pivot(
        "policy",
        {
            (code(policy), f"{of}, domain={corpus}"): shown
            for (corpus, setting, policy), found in measured().items()
            if setting == "reference"
            for of, shown in (("success", _rate(found, 4)), ("turns", f"{found['turns']:.2f}"))
        },
    )


@block("policies.comparison")
def _comparison() -> str:
    """Returns our simulator next to the public one on the public corpus."""
    rows = []
    for line in read_csv("public_simulator.csv"):
        theirs = {key: float(line[key]) for key in ("success_rate", "standard_error")}
        ours = measured()["miulab", line["setting"], line["policy"]]
        spread = math.hypot(theirs["standard_error"], ours["standard_error"])
        difference = f"{(ours['success_rate'] - theirs['success_rate']) / spread:+.1f}"
        rows.append(
            (line["setting"], code(line["policy"]), *map(_rate, (theirs, ours)), difference)
        )
    head = ("goals, slot errors", "policy", "public simulator", "ours", "difference / its error")
    return table(head, rows, numbers=3)
