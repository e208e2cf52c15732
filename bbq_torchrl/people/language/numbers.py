"""Words for small numbers, and numbers of people: one key for every way to say the same."""

from __future__ import annotations

import re

from bbq_torchrl.people.language.english import ENGLISH, word_set
from bbq_torchrl.people.language.words import tokenize

UNITS = ENGLISH["units"].split()
"""Zero to nineteen."""

TENS = {20: "twenty", 30: "thirty", 40: "forty", 50: "fifty"}

ORDINALS = ENGLISH["ordinals"].split()
"""First to twentieth."""

TEN_WORDS = {word: ten for ten, word in TENS.items()}
_NUMBERS = {word: number for number, word in enumerate(UNITS)} | TEN_WORDS
NUMBER_WORDS = frozenset(_NUMBERS)

_ALONE, _COMPANIONS, _PAIRS, _COMPANIES = map(
    word_set, ("alone", "companions", "pairs", "companies")
)
COUNT_WORDS = frozenset(
    NUMBER_WORDS | _ALONE | _COMPANIONS | _PAIRS | _COMPANIES | word_set("around_counts")
)


def number_of(word: str) -> int | None:
    """Returns the number that a word or at most four digits name, else ``None``."""
    if word.isdecimal() and word.isascii():
        return int(word) if len(word) <= 4 else None
    return _NUMBERS.get(word)


def read_count(text: str) -> str | None:
    """Returns the key of a number of people, else ``None``.

    Examples:
        >>> [read_count(t) for t in ("two", "me and my wife", "3 of my friends and me", "-3")]
        ['2', '2', '4', None]
    """
    words = tokenize(text.replace("-", " ") if not re.search(r"-\s*\d", text) else text)
    words = ["with" if word == "w" else word for word in words]
    words = [re.sub(r"(?<=\d)x$", "", word) for word in words]  # "2x"
    numbers = [number for word in words if (number := number_of(word)) is not None]
    if any(
        re.fullmatch(r"-\d+", word) or (word.isdecimal() and number_of(word) is None)
        for word in words
    ):
        return None
    has_me = any(word in ("me", "i", "my", "myself") for word in words)
    if len(numbers) > 1:
        return None
    if "dozen" in words:
        total = 6 if "half" in words else 12 * sum(numbers or [1])
        return str(total) if 0 < total <= 99 else None
    if numbers:
        is_plus = has_me and bool({"+", "plus"} & set(words))
        is_plus |= (
            bool(_COMPANIES & set(words)) and (has_me or "with" in words) and "us" not in words
        )
        total = numbers[0] + is_plus * (1 + sum(word in _COMPANIONS for word in words))
        return str(total) if 0 < total <= 99 else None
    if {"couple", "pair", "both"} & set(words):
        return "2"
    companions = sum((word in _COMPANIONS) + 2 * (word in _PAIRS) for word in words)
    if companions and (has_me or "with" in words or words[:1] == ["a"]):
        return str(1 + companions)
    if _ALONE & set(words) or " ".join(words) in ENGLISH["just_me"]:
        return "1"
    return None
