"""Tables of how the scripted policies and the privileged one do, from results/policies.json."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.docs_blocks.markdown import code, table

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["policies_blocks", "success_rate"]

FILE = Path(__file__).resolve().parents[2] / "results" / "policies.json"
MAKE = "python scripts/measure_policies.py --miulab <folder>"

PUBLIC: dict[tuple[str, str], tuple[float, float]] = {
    ("v1, no error", "rule"): (0.416, 0.011),
    ("v1, no error", "rule_inform"): (0.560, 0.011),
    ("v1, no error", "careful_essential"): (0.850, 0.005),
    ("v1, no error", "careful"): (0.9205, 0.006),
    ("v2, no error", "rule"): (0.286, 0.014),
    ("v2, no error", "rule_inform"): (0.441, 0.016),
    ("v2, no error", "careful"): (0.824, 0.010),
    ("v2, error .05", "rule"): (0.191, 0.005),
}
"""(setting, policy) -> success rate and standard error of the public simulator on its corpus."""


def policies_blocks() -> dict[str, Callable[[], str]]:
    """Returns the blocks about policies that do not learn."""
    return {"policies.reference": _reference, "policies.comparison": _comparison}


def _entries() -> list[dict[str, Any]]:
    return json.loads(FILE.read_text(encoding="utf-8"))


def success_rate(corpus: str, setting: str, policy: str) -> float | None:
    """Returns what was measured; None if it was not."""
    wanted = (corpus, setting, policy)
    for entry in _entries():
        if (entry["corpus"], entry["setting"], entry["policy"]) == wanted:
            return entry["result"]["success_rate"]
    return None


def _reference() -> str:
    """Returns every policy in the reference setting of both corpora, with the commands."""
    entries = [entry for entry in _entries() if entry["setting"] == "reference"]
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
        f"{table(head, rows, numbers=4)}\n\n"
        f"(± one standard error; written by `{MAKE}`, which runs)\n\n```bash\n{commands}\n```"
    )


def _comparison() -> str:
    """Returns our simulator beside the public one on the public corpus."""
    entries = {
        (entry["setting"], entry["policy"]): entry["result"]
        for entry in _entries()
        if entry["corpus"] == "miulab"
    }
    rows = []
    for key, (rate, error) in PUBLIC.items():
        setting, policy = key
        ours = entries.get(key)
        difference = "–"
        if ours is not None:
            spread = math.hypot(error, ours["standard_error"])
            difference = f"{(ours['success_rate'] - rate) / spread:+.1f}"
        rows.append(
            (
                setting,
                code(policy),
                f"{rate:.3f} ± {error:.3f}",
                "–" if ours is None else _rate(ours),
                difference,
            )
        )
    head = ("goals, slot errors", "policy", "public simulator", "ours", "difference / its error")
    return table(head, rows, numbers=3)


def _rate(result: dict[str, Any]) -> str:
    return f"{result['success_rate']:.4f} ± {result['standard_error']:.4f}"
