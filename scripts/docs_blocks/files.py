"""Blocks that show files: examples, and reports in results/."""

from __future__ import annotations

import sys

from bbq_torchrl.utils.statistics import estimate
from scripts.docs_blocks.common import RESULTS, ROOT, block, code, pivot, read_csv, short, table

EXAMPLES = ROOT / "examples"
_SUMMARY = {
    "booked after 1,000": "booked_after_1000",
    "final success": "success_after_2000",
    "pass^8": "pass_8",
}
"""Column of the benchmark's summary -> column of its file."""


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
    """Returns the means of the published benchmark in each domain, the earliest agents first."""
    values: dict[str, dict[str, list[float]]] = {}
    for row in read_csv("bench/bench.csv"):
        of_agent = values.setdefault(row["agent"], {})
        for name, column in _SUMMARY.items():
            of_agent.setdefault(f"{row['domain']}: {name}", []).append(float(row[column]))
    rows = [
        (code(agent), *(short(estimate(found).value) for found in of.values()))
        for agent, of in values.items()
    ]
    rows.sort(key=lambda row: row[1], reverse=True)
    columns = next(iter(values.values()))
    return table(("agent", *columns), rows, numbers=len(columns))


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


@block("chat.strangers")
def _strangers() -> str:
    """Returns what came of the last sets of conversations typed by strangers to the code."""
    quantities = {
        "success by the study's judge": ("judge", None),
        "success as the person felt it": ("felt", None),
        "gave up": ("gave_up", None),
        "questions not answered in the next reply": ("unanswered", "questions"),
        "other than a yes to an offer: answered": ("after_offer_answered", "after_offer"),
        "follow-ups to no match that helped": ("no_match_helped", "no_match"),
        "heard a yes that was none": ("false_yes", None),
        "booked, or ended, against the person's will": ("against_will", None),
    }
    cells, rows = {}, read_csv("strangers.csv")
    for commit in list(dict.fromkeys(row["commit"] for row in rows))[-5:]:
        own = [row for row in rows if row["commit"] == commit]
        for name, (key, of) in quantities.items():
            total = len(own) if of is None else sum(int(row[of]) for row in own)
            cells[name, f"at {commit}"] = f"{sum(int(row[key]) for row in own)}/{total}"
        for name, has in (("whose card has no detail", False), ("whose card has one", True)):
            fit = [int(row["judge"]) for row in own if (row["details"] > "0") == has]
            cells[f"success of people {name}", f"at {commit}"] = f"{sum(fit)}/{len(fit)}"
    return pivot("", cells)
