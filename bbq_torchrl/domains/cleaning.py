"""Cleans a hand-typed corpus so that its values match, and counts the changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.specification import Goal
from bbq_torchrl.domains.values import RESERVED_TEXT, fold, misspellings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from bbq_torchrl.domains.domain import Domain
    from bbq_torchrl.domains.miulab import Corpus


def cleaned(
    corpus: Corpus, files: Mapping[str, Path], left_out: Iterable[str]
) -> tuple[Corpus, list[str]]:
    """Returns a corpus with single blanks, and with every value in its most frequent spelling.

    Args:
        corpus: records, goals and lists of values.
        files: the file of each, which the sentences about changes name.
        left_out: slots to remove everywhere.

    Returns:
        The corpus, and one sentence for each kind of change.
    """
    out = set(left_out)

    def kept(entry: Mapping[str, str]) -> dict[str, str]:
        return {slot: " ".join(text.split()) for slot, text in entry.items() if slot not in out}

    records = {row: kept(entry) for row, entry in corpus["records"].items()}
    goals = {
        number: Goal(
            kept(goal.constraints), tuple(slot for slot in goal.requests if slot not in out)
        )
        for number, goal in corpus["goals"].items()
    }
    lists = {
        slot: [" ".join(text.split()) for text in texts]
        for slot, texts in corpus["error_values"].items()
        if slot not in out
    }
    usual = {
        (item.slot, fold(item.text)): item.usual
        for item in misspellings(tuple(records.values()), tuple(goals.values()), lists)
    }

    def spelled(entry: Mapping[str, str]) -> dict[str, str]:
        return {slot: usual.get((slot, fold(text)), text) for slot, text in entry.items()}

    after: Corpus = {
        "records": {row: spelled(entry) for row, entry in records.items()},
        "goals": {
            number: Goal(spelled(goal.constraints), goal.requests) for number, goal in goals.items()
        },
        "error_values": {
            slot: tuple(usual.get((slot, fold(text)), text) for text in texts)
            for slot, texts in lists.items()
        },
    }
    return after, list(_changes(corpus, after, files, out))


def only_in_goals(domain: Domain) -> dict[str, tuple[str, ...]]:
    """Returns, for each slot, the values that occur only in goals, not in lists or records."""
    known = {(slot, fold(text)) for slot, texts in domain.error_values.items() for text in texts}
    known |= {(slot, fold(text)) for record in domain.records for slot, text in record.items()}
    known |= {(slot, fold(text)) for slot in domain.slots for text in RESERVED_TEXT.values()}
    found: dict[str, dict[str, str]] = {}
    for goal in domain.goals:
        for slot, text in goal.constraints.items():
            if (slot, fold(text)) not in known:
                found.setdefault(slot, {}).setdefault(fold(text), text)
    return {slot: tuple(texts.values()) for slot, texts in found.items()}


def _changes(
    before: Corpus, after: Corpus, files: Mapping[str, Path], out: set[str]
) -> Iterator[str]:
    """Yields, for each file, the slots left out and the number of values respelled."""
    for field, path in files.items():
        entries = before[field]
        dropped = Counter(
            slot for key, entry in entries.items() for slot in _slots(key, entry) & out
        )
        for slot, count in dropped.items():
            yield f"{path.name}: {slot} is left out of {count} of {len(entries)} entries"
        old, new = (
            [pair for key, entry in some.items() for pair in _pairs(key, entry)]
            for some in (entries, after[field])
        )
        old = [pair for pair in old if pair[0] not in out]
        if other := sum(one != two for one, two in zip(old, new, strict=True)):
            yield (
                f"{path.name}: {other} of {len(old)} values are respelled, with single blanks or "
                "in the most frequent spelling"
            )


def _pairs(key: str, entry: Any) -> list[tuple[str, str]]:
    """Returns the (slot, value) pairs of a record, a goal or a slot's list."""
    if isinstance(entry, Goal):
        entry = entry.constraints
    return list(entry.items()) if isinstance(entry, Mapping) else [(key, text) for text in entry]


def _slots(key: str, entry: Any) -> set[str]:
    """Returns the slots that a record, a goal or a list names."""
    named = {slot for slot, _ in _pairs(key, entry)}
    return named | {*entry.requests} if isinstance(entry, Goal) else named
