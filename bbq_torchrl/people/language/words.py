"""Text as the nlu reads it: cleaned, folded and split into words."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from bbq_torchrl.utils.text import TextError, clean

ENGLISH: dict[str, Any] = yaml.safe_load(
    Path(__file__).with_name("english.yaml").read_text(encoding="utf-8")
)
"""The entries of the file by name."""


def word_set(name: str) -> frozenset[str]:
    """Returns the words of an entry that is written as ``"word word"``."""
    return frozenset(ENGLISH[name].split())


def pairs(name: str) -> dict[str, str]:
    """Returns the pairs of an entry that is written as ``"word:other word:other"``."""
    return dict(pair.split(":") for pair in ENGLISH[name].split())


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
_LONG = re.compile(r"([a-hj-z])\1\1+(?![a-z])")  # "yesss", but "creed iii"

SMALL = word_set("small")
"""Words that carry no information in a name."""

_SHORT = pairs("short")
"""The abbreviations in text messages, and the full words that they stand for."""
_APOSTROPHES = str.maketrans({"’": "'", "‘": "'", "`": "'", "´": "'", "“": '"', "”": '"', "–": "-"})


def legible(text: str) -> str:
    """Returns a clean text in plain letters and marks, without control characters.

    Raises:
        TextError: if the text is too long, or blank.
    """
    line = unicodedata.normalize("NFKC", clean(text).translate(_APOSTROPHES))
    return " ".join(
        "".join(letter for letter in line if unicodedata.category(letter)[0] != "C").split()
    )


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
        >>> tokenize("nooo, yesss")
        ['no', ',', 'yes']
    """
    said = _LONG.sub(r"\1", normalize(text))
    return [_SHORT.get(word, word) for word in _TOKEN.findall(said)]


def words_of(text: str) -> list[str]:
    """Returns the words of a typed text, see :func:`legible` and :func:`tokenize`.

    Raises:
        TextError: if the text is too long, or has no words.
    """
    words = tokenize(legible(text))
    if not words:
        raise TextError("a message must have at least one word, number or mark")
    return words


def compact(text: str) -> str:
    """Returns the letters and digits of a text: the part that two spellings of a name share.

    Examples:
        >>> compact("PG-13") == compact("pg13")
        True
    """
    return "".join(letter for letter in normalize(text) if letter.isalnum() or letter in "$&%")


_YES, _NO, _BESIDE = (word_set(name) for name in ("yes_words", "no_words", "beside_yes_and_no"))
POLITE = _YES | _NO | _BESIDE | word_set("polite")
"""Words of agreement and thanks, which name no value by themselves."""


def is_no(text: str) -> bool:
    """Returns whether a text is a plain no.

    Examples:
        >>> [is_no(text) for text in ("No, that's not right", "no, at 7")]
        [True, False]
    """
    words = set(tokenize(text))
    return bool(words & _NO) and words <= _NO | _YES | _BESIDE


def is_farewell(text: str) -> bool:
    """Returns whether a text contains words of farewell.

    Examples:
        >>> [is_farewell(text) for text in ("ok, bye", "forget the date. any date")]
        [True, False]
    """
    return has_bye(text) or _has_phrase(text, "farewell")


def has_bye(text: str) -> bool:
    """Returns whether a text takes leave in so many words.

    Examples:
        >>> [has_bye(text) for text in ("thanks, bye", "see you!", "thanks, that's all")]
        [True, True, False]
    """
    return _has_phrase(text, "bye")


def _has_phrase(text: str, entry: str) -> bool:
    words = f" {' '.join(tokenize(text))} "
    return any(f" {phrase} " in words for phrase in ENGLISH[entry])


OUTSIDE = "-"
"""The tag of a word that is not part of a value."""


class Span(NamedTuple):
    """Words that name a value.

    Attributes:
        slot: the slot of the value.
        start: the first word.
        end: the word after the last.
    """

    slot: str
    start: int
    end: int


def spans_of(tags: Sequence[str]) -> list[Span]:
    """Returns the spans that tags mark.

    Examples:
        >>> spans_of([OUTSIDE, "city", "city", "date"])
        [Span(slot='city', start=1, end=3), Span(slot='date', start=3, end=4)]
    """
    spans = []
    for slot, tagged in groupby(enumerate(tags), key=lambda item: item[1]):
        places = [at for at, _ in tagged]
        if slot != OUTSIDE:
            spans.append(Span(slot, places[0], places[-1] + 1))
    return spans


def untagged(words: Sequence[str], tags: Sequence[str]) -> list[str]:
    """Returns the words, with ``""`` in place of those that are part of a value."""
    return [word if tag == OUTSIDE else "" for word, tag in zip(words, tags, strict=True)]
