"""The words for small numbers, and which number a word is."""

from __future__ import annotations

__all__ = ["NUMBER_WORDS", "ORDINALS", "TENS", "TEN_WORDS", "UNITS", "number_of"]

UNITS = """
    zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen
    fifteen sixteen seventeen eighteen nineteen
""".split()
"""Zero to nineteen."""

TENS = {20: "twenty", 30: "thirty", 40: "forty", 50: "fifty"}

ORDINALS = """
    first second third fourth fifth sixth seventh eighth ninth tenth eleventh twelfth
    thirteenth fourteenth fifteenth sixteenth seventeenth eighteenth nineteenth twentieth
""".split()
"""First to twentieth."""

TEN_WORDS = {word: ten for ten, word in TENS.items()}
_NUMBERS = {word: number for number, word in enumerate(UNITS)} | TEN_WORDS
NUMBER_WORDS = frozenset(_NUMBERS)


def number_of(word: str) -> int | None:
    """Returns the number that a word or at most four digits name, else ``None``."""
    if word.isdecimal() and word.isascii():
        return int(word) if len(word) <= 4 else None
    return _NUMBERS.get(word)
