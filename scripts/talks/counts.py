"""Counts of conversations: what is counted, and the table ``results/talks.csv``."""

from __future__ import annotations

import csv
from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

COUNTS = (
    "talks", "success", "texts", "values", "dropped", "acted", "wrong", "questions", "answered",
    "late_questions", "late_answered", "asked", "repeated", "yes", "yes_ends", "never",
    "turned_round", "unknown", "reported", "cut_off",
)  # fmt: skip
"""The counts of a conversation; :class:`~talks.talk.Talk` says what each is."""

SHARES = {
    "success": ("success", "talks"),
    "questions answered in the next reply": ("answered", "questions"),
    "the same, after an offer": ("late_answered", "late_questions"),
    "questions repeated without news, of all texts": ("repeated", "texts"),
    "a yes to an offer ends it": ("yes_ends", "yes"),
    "values dropped": ("dropped", "values"),
    "acts on something else than was meant": ("wrong", "acted"),
    "excluded values taken for wishes": ("turned_round", "never"),
    "unknown names reported or asked about": ("reported", "unknown"),
    "ended by the agent without a yes or farewell": ("cut_off", "talks"),
    "texts of the person": ("texts", "talks"),
}
"""The name of a share, and the two counts that it is made of."""

_KEYS = ("label", "agent", "kind")


def total(rows: Iterable[Mapping[str, object]]) -> Counter[str]:
    """Returns the sums of all counts."""
    found: Counter[str] = Counter()
    for row in rows:
        found.update({name: int(str(row[name])) for name in COUNTS})
    return found


def shares(rows: Iterable[Mapping[str, object]]) -> dict[str, str]:
    """Returns each share of :data:`SHARES` as text."""
    found = total(rows)
    return {
        name: "–" if not found[whole] else f"{found[part] / found[whole]:.3f}"
        for name, (part, whole) in SHARES.items()
    }


def read(path: Path) -> list[dict[str, str]]:
    """Returns the rows of a table, one a label, agent and kind; none without a file."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def save(path: Path, rows: Iterable[Mapping[str, object]], label: str, agent: str) -> None:
    """Writes the sums of each kind into a table, in place of those of this label and agent."""
    kept = [row for row in read(path) if (row["label"], row["agent"]) != (label, agent)]
    by_kind: dict[str, list[Mapping[str, object]]] = {}
    for row in rows:
        by_kind.setdefault(str(row["kind"]), []).append(row)
    sums = [
        {"label": label, "agent": agent, "kind": kind, **total(found)}
        for kind, found in by_kind.items()
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, (*_KEYS, *COUNTS), lineterminator="\n")
        writer.writeheader()
        writer.writerows([*kept, *sums])
