"""Values: the reserved ids, how two texts compare, and texts that look the same but differ.

The simulator represents each slot's value as an integer id. The first four ids are reserved, with
the same meaning in every slot of every domain; the values of the slot follow from
:data:`FIRST_VALUE` on.
"""

from __future__ import annotations

import unicodedata
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

NONE = 0
"""The slot has no value."""

DONT_CARE = 1
"""The user has no preference. It matches every record."""

NO_MATCH = 2
"""The agent found no matching record with a value. It matches no record."""

AVAILABLE = 3
"""At least one record can be booked. Only the ticket and the complete slot take this value."""

FIRST_VALUE = 4
"""The first id that is not reserved."""

RESERVED_TEXT: dict[int, str] = {
    DONT_CARE: "I do not care",
    NO_MATCH: "no match",
    AVAILABLE: "ticket available",
}
"""The reserved values as text, in corpora and transcripts."""


def fold(text: str) -> str:
    """Returns the form in which two values are compared: without case.

    White space counts: the public movie corpus has ``" standard"`` and ``"standard"``, which do not
    match.

    Examples:
        >>> fold("Deadpool") == fold("deadpool")
        True
    """
    return text.casefold()


def value_ids(vocabulary: Iterable[Sequence[str]]) -> list[dict[str, int]]:
    """Returns, per slot, the id of each value by its folded text.

    Args:
        vocabulary: per slot, id to text.
    """
    return [{fold(text): id_ for id_, text in enumerate(texts)} for texts in vocabulary]


_ALIKE = {
    **dict.fromkeys("\u2018\u2019\u201a\u201b\u02bc\u2032\u00b4\u0060", "'"),
    **dict.fromkeys("\u201c\u201d\u201e\u201f\u2033\u00ab\u00bb", '"'),
    **dict.fromkeys("\u2010\u2011\u2012\u2013\u2014\u2015\u2212", "-"),
}
DIFFERENCE = "only in blanks, quotes, dashes or how letters are encoded"
"""The possible differences of values whose :func:`plain` forms are equal."""

_LETTERS = str.maketrans(_ALIKE)
_RESERVED = {fold(text): text for text in RESERVED_TEXT.values()}


class Misspelling(NamedTuple):
    """A value that looks like another value of its slot but does not match it.

    Attributes:
        field: the field of the domain that has it.
        entry: the index of the record or goal, or the slot of the list.
        slot: its slot.
        text: its spelling.
        usual: the most frequent spelling, or a reserved value.
    """

    field: str
    entry: int | str
    slot: str
    text: str
    usual: str

    def __str__(self) -> str:
        # In ASCII, which shows a no-break space and a letter of two characters.
        return f"{self.slot} = {self.text!a}, which never matches {self.usual!a}"


@lru_cache(maxsize=50_000)
def plain(text: str) -> str:
    r"""Returns a value's visible content: without case, with one kind of blank, quote and dash.

    Compatibility forms of letters (NFKC) are unified. Leading, trailing and repeated blanks and
    characters without width are removed.

    Examples:
        >>> plain(" Freddy\u2019s\u00a0 Pizza") == plain("freddy's pizza")
        True
    """
    folded = fold(text)
    if not folded.isascii():
        folded = unicodedata.normalize("NFKC", fold(folded.translate(_LETTERS)))
        folded = "".join(letter for letter in folded if unicodedata.category(letter) != "Cf")
    return " ".join(folded.translate(_LETTERS).split())


def misspellings(
    records: Sequence[Mapping[str, str]],
    goals: Sequence[Any],
    error_values: Mapping[str, Iterable[str]],
) -> list[Misspelling]:
    """Finds values of a slot that do not match although their :func:`plain` forms are equal.

    Args:
        records: slot to value.
        goals: the users' goals, :class:`~bbq_torchrl.domains.Goal`.
        error_values: slot to values.
    """
    entries: list[tuple[str, int | str, Iterable[tuple[str, str]]]] = [
        *(("records", row, record.items()) for row, record in enumerate(records)),
        *(("goals", number, goal.constraints.items()) for number, goal in enumerate(goals)),
        *(
            ("error_values", slot, [(slot, text) for text in texts])
            for slot, texts in error_values.items()
        ),
    ]
    written: dict[tuple[str, str], list[tuple[str, int | str, str]]] = defaultdict(list)
    for field, entry, pairs in entries:
        for slot, text in pairs:
            if isinstance(text, str):
                written[slot, plain(text)].append((field, entry, text))
    found = []
    for (slot, key), items in written.items():
        spellings = Counter(fold(text) for *_, text in items)
        reserved = _RESERVED.get(key)
        if len(spellings) == 1 and (reserved is None or fold(reserved) in spellings):
            continue
        most = spellings.most_common(1)[0][0]
        usual = reserved or next(text for *_, text in items if fold(text) == most)
        found += [
            Misspelling(field, entry, slot, text, usual)
            for field, entry, text in items
            if fold(text) != fold(usual)
        ]
    return found


def unlisted(
    records: Sequence[Mapping[str, str]],
    goals: Sequence[Any],
    error_values: Mapping[str, Iterable[str]],
) -> Iterator[tuple[int, str, str]]:
    """Yields the goal's index, the slot and the value of goals whose value nothing else has.

    In a hand-written corpus such a value is a typing error. Values that differ only in spelling are
    misspellings instead, and reserved values have a meaning.

    Args:
        records: slot to value.
        goals: the users' goals, :class:`~bbq_torchrl.domains.Goal`.
        error_values: slot to values.
    """
    known = {(slot, plain(text)) for slot, texts in error_values.items() for text in texts}
    known |= {(slot, plain(text)) for record in records for slot, text in record.items()}
    for number, goal in enumerate(goals):
        for slot, text in goal.constraints.items():
            is_text = isinstance(text, str) and plain(text) not in _RESERVED
            if is_text and (slot, plain(text)) not in known:
                yield number, slot, text
