"""Text as the understanding reads it: cleaned, folded, in words."""

from __future__ import annotations

import re
import unicodedata

from bbq_torchrl.people.language.english import pairs

MAX_CHARACTERS = 1_000
"""The longest text that is read; nobody types more to a ticket agent."""

BREAKS = frozenset((".", ";", "!", "?"))
"""The marks between clauses."""

_TOKEN = re.compile(
    r"\d{1,2}(?:[:.h]\d\d)?(?=\s?[ap]\.?m\b)"  # 7 of "7pm", 8.30 of "8.30 pm"
    r"|\d+(?:[:.,/]\d+)+"  # 7:30, 3/14, 4.5/5
    r"|\d+(?=(?:st|nd|rd|th)\b)"  # 14 of "14th"
    r"|[ap]\.m\b\.?"
    r"|-?\d+(?![\w])"
    r"|x(?=\d+\b)"  # x of "x2"
    r"|[^\W_]+(?:['’][^\W_]+)*"
    r"|[^\w\s]"
)


_SHORT = pairs("short")
"""Words as short messages have them, which are read as the long ones."""
_APOSTROPHES = str.maketrans({"’": "'", "‘": "'", "`": "'", "´": "'", "“": '"', "”": '"', "–": "-"})


class TextError(ValueError):
    """Text that cannot be read as a sentence; the message is fit to be shown to its author."""


def clean(text: str) -> str:
    r"""Returns ``text`` in one line without controls, marks of direction and broken characters.

    Raises:
        TextError: if the text is longer than :data:`MAX_CHARACTERS`, or nothing is left of it.

    Examples:
        >>> clean("  two\x00 tickets\n please ")
        'two tickets please'
    """
    if len(text) > MAX_CHARACTERS:
        raise TextError(
            f"a sentence may have at most {MAX_CHARACTERS:,} characters, got {len(text):,}"
        )
    composed = unicodedata.normalize("NFKC", text.translate(_APOSTROPHES))
    kept = "".join(
        " " if letter.isspace() else letter
        for letter in composed
        if letter.isspace() or unicodedata.category(letter)[0] != "C"
    )
    line = " ".join(kept.split())
    if not line:
        raise TextError("a sentence must have at least one character that can be read, got none")
    return line


def normalize(text: str) -> str:
    """Returns ``text`` without case and accents.

    Examples:
        >>> normalize("Timothée Chalamet")
        'timothee chalamet'
    """
    if text.isascii():
        return text.lower()
    parts = unicodedata.normalize("NFKD", text.casefold())
    return "".join(letter for letter in parts if not unicodedata.combining(letter))


def tokenize(text: str) -> list[str]:
    """Returns the words, numbers and marks of a text, without case, accents and short forms.

    Examples:
        >>> tokenize("Barbie at 7:30pm, the 14th!")
        ['barbie', 'at', '7:30', 'pm', ',', 'the', '14', 'th', '!']
        >>> tokenize("2 tix 4 fri nite")
        ['2', 'tickets', '4', 'fri', 'night']
    """
    return [_SHORT.get(word, word) for word in _TOKEN.findall(normalize(text))]


def words_of(text: str) -> list[str]:
    """Returns the words of what somebody typed, see :func:`clean` and :func:`tokenize`.

    Raises:
        TextError: if the text is longer than :data:`MAX_CHARACTERS`, or has no words.
    """
    words = tokenize(clean(text))
    if not words:
        raise TextError("a sentence must have at least one word, number or mark, got none")
    return words


def compact(text: str) -> str:
    """Returns the letters and digits of a text: what two spellings of a name share.

    Examples:
        >>> compact("PG-13") == compact("pg13")
        True
    """
    return "".join(letter for letter in normalize(text) if letter.isalnum() or letter in "$&%")
