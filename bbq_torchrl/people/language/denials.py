"""Denials: whether the words around a value reject it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from bbq_torchrl.people.language.words import ENGLISH

if TYPE_CHECKING:
    from collections.abc import Sequence

CLAUSE = re.compile(r"[^\w' ]")
"""A mark that ends a clause."""

_MAX_BEFORE, _MAX_AFTER = 8, 6  # words
_DENIED_BEFORE, _DENIED_AFTER = (
    [re.compile(pattern.replace("<gap>", ENGLISH["denial_gap"])) for pattern in ENGLISH[name]]
    for name in ("denied_before", "denied_after")
)
_NO = re.compile(ENGLISH["denied_by_no"])


def is_denied(words: Sequence[str], start: int, end: int, *, is_first: bool = True) -> bool:
    """Returns whether the words around a name reject it.

    After another name of its slot, and before a number, a "no" retracts what was said before.

    Args:
        words: the words of the sentence.
        start: the first word of the name.
        end: the word after its last.
        is_first: whether no other name of its slot precedes it.
    """
    before = CLAUSE.split(" ".join(words[max(start - _MAX_BEFORE, 0) : start]))[-1].strip()
    after = CLAUSE.split(" ".join(words[end : end + _MAX_AFTER]))[0].strip()
    if words[end - 1].endswith("'s"):
        after = f"'s {after}"  # "Friday's no good"
    says_no = is_first and not any(map(str.isdigit, "".join(words[start:end])))
    return (
        (says_no and _NO.search(before) is not None)
        or any(pattern.search(before) for pattern in _DENIED_BEFORE)
        or any(pattern.search(after) for pattern in _DENIED_AFTER)
    )
