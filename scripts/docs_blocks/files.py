"""Blocks that show files: examples, and reports in results/."""

from __future__ import annotations

import re
import shutil
import sys
from typing import TYPE_CHECKING

from bbq_torchrl.utils.statistics import estimate
from scripts.docs_blocks.common import FIGURES, RESULTS, ROOT, block, code, read_csv, table
from scripts.talks.counts import SHARES, shares

if TYPE_CHECKING:
    from collections.abc import Mapping

EXAMPLES = ROOT / "examples"
_SUMMARY = {
    "booked after 1,000": "booked_after_1000",
    "final success": "success_after_2000",
    "pass^8": "pass_8",
}
"""Column of the benchmark's summary -> column of its file."""
_FEW = "five cards"  # the label of the measurement of all agents


@block("deep_sea.results")
def _deep_sea() -> str:
    sys.path.append(str(EXAMPLES / "deep_sea"))  # an example is a folder of scripts, no package
    import deep_sea_results as sea

    return sea.table(sea.read(), list(sea.AGENT_NAMES))


def _extending(name: str) -> str:
    """Returns a file of the example package as a code block."""
    file = EXAMPLES / "extending" / "bbq_extending" / f"{name}.py"
    return f"```python\n{file.read_text(encoding='utf-8')}```"


for _name in ("ucb_policy", "ucb"):
    block(f"extending.{_name}", _name)(_extending)


@block("study.uncertainty")
def _uncertainty() -> str:
    """Returns the table on uncertainty as a predictor of failure."""
    text = (RESULTS / "study" / "uncertainty" / "report.md").read_text(encoding="utf-8")
    return text.split("\n## Does uncertainty predict failure?")[1].split("\n## ")[0]


@block("bench.summary")
def _bench_summary() -> str:
    """Returns a table of the published benchmark for each domain, the earliest agents first."""
    by_domain: dict[str, dict[str, list[Mapping[str, str]]]] = {}
    for row in read_csv("bench/bench.csv"):
        by_domain.setdefault(row["domain"], {}).setdefault(row["agent"], []).append(row)
    tables = []
    for domain, agents in by_domain.items():
        rows = [
            (code(agent), *(estimate([float(row[key]) for row in of]) for key in _SUMMARY.values()))
            for agent, of in agents.items()
        ]
        rows.sort(key=lambda row: row[1].value, reverse=True)
        head = (f"domain {code(domain)}, errors at the reference", *_SUMMARY)
        tables.append(table(head, [(row[0], *map(str, row[1:])) for row in rows]))
    return "\n\n".join(tables)


@block("study.simulated")
def _simulated() -> str:
    """Returns the agents and the declared pairs of the study with simulated users."""
    text = (RESULTS / "study" / "report.md").read_text(encoding="utf-8")
    text = text[text.index("## Agents") : text.index("## Distribution")]
    text = re.sub(r"\]\((\w+)\.png\)", r"](figures/study_simulated_\1.png)", text)
    return text.replace("## ", "#### ")


@block("chat.control")
def _control() -> str:
    """Returns the table of the costs of the dialogue control's rules in the simulator."""
    rows = [
        (
            row["rules"],
            f"{float(row['success']):.3f} ± {float(row['standard_error']):.3f}",
            row["turns"],
        )
        for row in read_csv("control.csv")
    ]
    return table(("rules", "success", "turns"), rows)


@block("environment.users")
def _users() -> str:
    """Returns the table of agents by the users they learned from and play with."""
    found: dict[tuple[str, ...], dict[str, list[dict[str, str]]]] = {}
    for row in read_csv("users.csv"):
        run = (row["agent"], row["trained_on"] or "–", row["rounds"] or "–")
        found.setdefault(run, {}).setdefault(row["played_with"], []).append(row)
    head = ("agent", "trained on", "rounds", "runs", "paper", "people")
    more = ("answers at once", "after an offer", "warns of people", "warns of failure")
    keys = ("answers", "answers_after_offer", "warns_of_users", "warns_of_failure")
    rows = [
        (
            *(*run, str(len(played["people"]))),
            *(_mean(played[users], "success") for users in ("paper", "people")),
            *(_mean(played["people"], key) for key in keys),
        )
        for run, played in found.items()
    ]
    return table((*head, *more), rows)


def _mean(rows: list[dict[str, str]], key: str) -> str:
    """Returns the mean of a column, and its range over several runs."""
    values = [float(row[key]) for row in rows if row[key] not in ("", "nan")]
    if not values:
        return "–"
    mean = f"{sum(values) / len(values):.2f}"
    return mean if len(values) == 1 else f"{mean} ({min(values):.2f}–{max(values):.2f})"


def _shares(columns: Mapping[str, tuple[str, str]]) -> str:
    """Returns the shares of conversations, a column for each name of a label and an agent."""
    rows = read_csv("talks.csv")
    found = [
        shares(row for row in rows if (row["label"], row["agent"]) == column)
        for column in columns.values()
    ]
    lines = [(name, *(part[name] for part in found)) for name in SHARES]
    return table(("", *columns), lines, numbers=len(columns))


@block("chat.talks")
def _talks() -> str:
    """Returns the shares of conversations before and after the control that answers at once."""
    return _shares({name: (name, "shipped:bbqn_map") for name in ("before", "after")})


@block("chat.talks_agents")
def _talks_of_agents() -> str:
    """Returns the shares of conversations of each shipped agent."""
    agents = {row["agent"]: None for row in read_csv("talks.csv") if row["label"] == _FEW}
    return _shares({agent.removeprefix("shipped:"): (_FEW, agent) for agent in agents})


def copy_figures() -> None:
    """Copies the figures of the reports in results/ to docs/figures/."""
    for report, names in (("study", ("success", "ratings")), ("bench", ("profiles", "booked"))):
        prefix = "study_simulated" if report == "study" else report
        for name in names:
            file = FIGURES / f"{prefix}_{name}.png"
            shutil.copyfile(RESULTS / report / f"{name}.png", file)
