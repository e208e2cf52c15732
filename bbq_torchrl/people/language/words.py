"""Text as the nlu reads it: cleaned, folded and split into words."""

from __future__ import annotations

import re
import unicodedata
from itertools import pairwise
from pathlib import Path
from typing import Any

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
    """
    return [_SHORT.get(word, word) for word in _TOKEN.findall(normalize(text))]


def words_of(text: str) -> list[str]:
    """Returns the words of a typed text, see :func:`legible` and :func:`tokenize`.

    Raises:
        TextError: if the text is too long, or has no words.
    """
    words = tokenize(legible(text))
    if not words:
        raise TextError("a message must have at least one word, number or mark")
    return words


def capitalized(text: str) -> frozenset[str]:
    """Returns the words inside a text's sentences that begin with a capital, as names do.

    Small words and words all in capitals are left out.

    Raises:
        TextError: if the text is too long, or blank.

    Examples:
        >>> sorted(capitalized("I liked Top Gun. Is Dune in IMAX?"))
        ['dune', 'gun', 'top']
    """
    found = {
        normalize(word)
        for before, word in pairwise(_TOKEN.findall(legible(text)))
        if word[0].isupper() and not word.isupper() and word[:2] != "I'" and before not in BREAKS
    }
    return frozenset(found - SMALL)


def compact(text: str) -> str:
    """Returns the letters and digits of a text: the part that two spellings of a name share.

    Examples:
        >>> compact("PG-13") == compact("pg13")
        True
    """
    return "".join(letter for letter in normalize(text) if letter.isalnum() or letter in "$&%")


_YES, _NO, _BESIDE = (word_set(name) for name in ("yes_words", "no_words", "beside_yes_and_no"))
_PLAIN_YES = word_set("plain_yes")
POLITE = _YES | _NO | _BESIDE | word_set("polite")
"""Words of agreement and thanks, which name no value by themselves."""


def is_yes(text: str) -> bool:
    """Returns whether a text is a plain yes.

    Examples:
        >>> [is_yes(text) for text in ("Yes, that's right!", "yes but at 7", "not right")]
        [True, False, False]
    """
    words = set(tokenize(text))
    return bool(words & _YES) and words <= _YES | _BESIDE


def has_yes(text: str) -> bool:
    """Returns whether a text says yes among other words, but not no.

    Examples:
        >>> [has_yes(text) for text in ("wonderful, yes please", "yes, not at 7", "I am sure")]
        [True, False, False]
    """
    words = set(tokenize(text))
    return not words.isdisjoint(_PLAIN_YES) and words.isdisjoint(_NO)


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
        >>> [has_bye(text) for text in ("thanks, bye", "thanks, that's all")]
        [True, False]
    """
    return _has_phrase(text, "bye")


def _has_phrase(text: str, entry: str) -> bool:
    words = f" {' '.join(tokenize(text))} "
    return any(f" {phrase} " in words for phrase in ENGLISH[entry])


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

NUMBER = rf"(?:{'|'.join(sorted(NUMBER_WORDS))}|\d\d?)"
"""A regular expression of a number."""

_MEMBER = rf"(?:{NUMBER}|an?) (?:{'|'.join(sorted(word_set('members')))})"
_JOIN = "|".join(map(re.escape, sorted(word_set("members_join"))))
PARTY = re.compile(rf"(?<!\S){_MEMBER}(?: (?:(?:{_JOIN}) )*{_MEMBER})+(?!\S)")
"""Several sorts of people, each with its number: "2 adults and a child"."""


def number_of(word: str) -> int | None:
    """Returns the number named by a word or by at most four digits, else ``None``."""
    if word.isdecimal() and word.isascii():
        return int(word) if len(word) <= 4 else None
    return _NUMBERS.get(word)


def read_count(text: str) -> str | None:
    """Returns the key of a number of people, else ``None``.

    Examples:
        >>> [read_count(t) for t in ("two", "me and my wife", "3 of my friends and me", "-3")]
        ['2', '2', '4', None]
        >>> read_count("2 adults and a child")
        '3'
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
    if (party := PARTY.search(" ".join(words))) is not None:
        members = [1 if word in ("a", "an") else number_of(word) or 0 for word in party[0].split()]
        total = sum(members) + bool({"me", "i", "myself"} & set(words))
        return str(total) if 0 < total <= 99 else None
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
