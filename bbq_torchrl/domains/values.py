"""The reserved value ids, which mean the same in every slot of every domain.

The simulator represents each slot's value as an integer id. The first four ids are reserved; the
values of the slot follow from :data:`FIRST_VALUE` on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

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
