"""Times, dates, prices and kinds of quantity: one canonical key for all ways to say the same.

The same reader makes the keys of a domain's values and of what people type, so the two match. A key
is text: ``"at 19:30"``, ``"friday night"``, ``"3/14"``, ``"2"``, ``"$10"``.
"""

from __future__ import annotations

import calendar
import re
from collections.abc import Callable, Iterable
from typing import Literal, get_args

from bbq_torchrl.people.language.words import ENGLISH, pairs, tokenize, word_set

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
    words = tokenize(text if re.search(r"-\s*\d", text) else text.replace("-", " "))
    words = [re.sub(r"(?<=\d)x$", "", "with" if word == "w" else word) for word in words]  # "2x"
    total = _people(words)
    return str(total) if 0 < total <= 99 else None


def _people(words: list[str]) -> int:
    """Returns the number of people in words of a phrase; 0 if they give none."""
    said = set(words)
    numbers = [number for word in words if (number := number_of(word)) is not None]
    others = [word for word in words if re.fullmatch(r"-?\d+", word) and number_of(word) is None]
    has_me = not said.isdisjoint(("me", "i", "my", "myself"))
    if (party := PARTY.search(" ".join(words))) is not None:
        members = [1 if word in ("a", "an") else number_of(word) or 0 for word in party[0].split()]
        return sum(members) + (not said.isdisjoint(("me", "i", "myself")))
    if others or len(numbers) > 1:
        return 0
    if "dozen" in said:
        return 6 if "half" in said else 12 * sum(numbers or [1])
    if numbers:
        is_plus = has_me and not said.isdisjoint(("+", "plus"))
        is_plus |= bool(_COMPANIES & said) and (has_me or "with" in said) and "us" not in said
        return numbers[0] + is_plus * (1 + sum(word in _COMPANIONS for word in words))
    if not said.isdisjoint(("couple", "pair", "both")):
        return 2
    companions = sum((word in _COMPANIONS) + 2 * (word in _PAIRS) for word in words)
    if companions and (has_me or "with" in said or words[0] == "a"):
        return 1 + companions
    return int(bool(_ALONE & said) or " ".join(words) in ENGLISH["just_me"])


Kind = Literal["text", "time", "date", "count", "price"]
KINDS: tuple[Kind, ...] = get_args(Kind)

_ORDINALS = {word: number for number, word in enumerate(ORDINALS, 1)} | {"thirtieth": 30}
_DAYS = tuple(day.lower() for day in calendar.day_name)
_DAY = {day[:length]: day for day in _DAYS for length in (3, len(day))} | pairs("days")
_MONTH = {
    name.lower(): number
    for names in (calendar.month_name, calendar.month_abbr)
    for number, name in enumerate(names)
    if number
} | {"sept": 9}
_PART = {part: part for part in ("morning", "afternoon", "evening", "night", "noon")}
_PART["eve"] = "evening"
_TOMORROW = {"tomorrow", "tomorow", "tommorow", "tommorrow"}
_DATE_FILLERS, _TIME_FILLERS = word_set("date_fillers"), word_set("time_fillers")
ORDINAL_WORDS = frozenset(_ORDINALS)
DAY_WORDS = frozenset({*_DAY, *_TOMORROW, "today", "tonight", "weekend", "wknd", "week"})
MONTH_WORDS = frozenset(_MONTH)
PART_WORDS = frozenset({*_PART, "midnight", "matinee", "midday"})
RELATION_WORDS = frozenset(
    ("after", "before", "around", "about", "past", "quarter", "half", "until")
)

_BEFORE_NOON = frozenset(("am", "a.m", "a.m.", "morning"))
_AFTER_NOON = frozenset(("pm", "p.m", "p.m.", "afternoon", "evening", "night", "tonight"))
_CLOCK = re.compile(r"(\d{1,2})[:.h](\d\d)")


def read_time(text: str) -> str | None:
    """Returns the key of a time of day, else ``None``.

    An hour without am or pm is marked by ``?`` and means the afternoon or evening if both exist.

    Examples:
        >>> [read_time(t) for t in ("7:30 pm", "half past seven", "1930", "after 6pm", "25:99")]
        ['at 19:30', 'at 19:30?', 'at 19:30', 'after 18:00', None]
    """
    joined = " ".join(tokenize(text))
    joined = re.sub(r"\b(?:around )?([\w:.]+?) ?-? ?ish\b", r"around \1", joined)
    relation = "at"
    for phrase, name in ENGLISH["relations"].items():
        if phrase in joined and re.search(
            rf"(^|\b(at|in|somewhere|something|anything|only|a bit|is) ){phrase}\b", joined
        ):
            relation, joined = name, joined.replace(phrase, " ", 1)
            if relation == "after":
                joined = re.sub(r"\b(about|around)\b", " ", joined)  # "from about 6"
            break
    for phrase, name in ENGLISH["ranges"].items():
        if joined.endswith(f" {phrase}"):
            relation, joined = name, joined.removesuffix(phrase)
    words = [word for word in joined.split() if word not in _TIME_FILLERS]
    meridian = None
    kept = []
    for word in words:
        if word in _BEFORE_NOON:
            meridian = 0
        elif word in _AFTER_NOON:
            meridian = 12
        else:
            kept.append(word)
    if kept in (["noon"], ["midday"]):
        return f"{relation} 12:00"
    if kept == ["midnight"]:
        return f"{relation} 00:00"
    clock = _clock(kept)
    if clock is None and meridian is not None and len(kept) == 2:
        clock = _clock([kept[0], "oh", kept[1]])  # "ten five pm"
    if clock is None:
        return None
    hour, minute, has_24 = clock
    if hour > 23 or minute > 59 or (hour > 12 and meridian == 0):
        return None
    if meridian is not None and hour <= 12:
        return f"{relation} {hour % 12 + meridian:02}:{minute:02}"
    if hour > 12 or has_24 or hour == 0:
        return f"{relation} {hour:02}:{minute:02}"
    return f"{relation} {hour % 12 + 12:02}:{minute:02}?"


def _clock(words: list[str]) -> tuple[int, int, bool] | None:
    """Returns the hour, the minute and whether the clock certainly has 24 hours."""
    if len(words) == 1:
        word = words[0]
        if match := _CLOCK.fullmatch(word):
            return int(match[1]), int(match[2]), len(match[1]) == 2 and match[1][0] == "0"
        if word.isdecimal() and word.isascii() and len(word) in (3, 4):
            return int(word[:-2]), int(word[-2:]), len(word) == 4
        number = number_of(word)
        return None if number is None or number > 24 else (number % 24, 0, False)
    joined = " ".join(words)
    match = re.fullmatch(
        r"(half|quarter|a quarter|\w+)(?: minutes)? (past|after|to|till|before) (\w+)", joined
    )
    if match:
        minutes = {"half": 30, "quarter": 15, "a quarter": 15}.get(match[1]) or number_of(match[1])
        hour = number_of(match[3])
        if minutes is None or hour is None or not 0 < minutes < 60 or hour > 24:
            return None
        return (
            (hour, minutes, False)
            if match[2] in ("past", "after")
            else ((hour - 1) % 12 or 12, 60 - minutes, False)
        )
    if match := re.fullmatch(r"(?:half (\w+)|(\w+) (?:a )?half)", joined):
        hour = number_of(match[1] or match[2])
        return None if hour is None else (hour, 30, False)
    hour = number_of(words[0]) if words else None
    if hour is None or not 1 <= hour <= 23:
        return None
    if len(words) == 2 and (minute := number_of(words[1])) is not None:
        return (hour, minute, False) if minute >= 10 else None
    if len(words) != 3:
        return None
    tens, unit = 0 if words[1] == "oh" else TEN_WORDS.get(words[1]), number_of(words[2])
    if tens is None or unit is None or unit > 9:
        return None
    return hour, tens + unit, False


def read_date(text: str) -> str | None:
    """Returns the key of a day, else ``None``.

    Examples:
        >>> [read_date(t) for t in ("this Friday night", "15 of march", "3/15", "the 9th")]
        ['friday night', '3/15', '3/15', 'day 9']
        >>> read_date("february 30"), read_date("barbie")
        (None, None)
    """
    words = [word for word in tokenize(text) if word not in _DATE_FILLERS]
    joined = " ".join(words)
    if joined == "after tomorrow":
        return "after tomorrow"
    joined = re.sub(r"\b(week end|week-end|week - end|wknd|weeknd)\b", "weekend", joined)
    words = joined.split()
    part = ""
    if len(words) > 1 and words[-1] in _PART:
        part = " " + _PART[words.pop()]
    elif len(words) == 2 and words[0] in _PART and words[1].rstrip("s") in _DAY:
        part = " " + _PART[words.pop(0)]  # "at night of friday"
    if words == ["tonight"]:
        return "today night"
    if words == ["this"] and part:
        return f"today{' night' if part == ' evening' else part}"
    if words in (["today"], ["later", "today"]):
        return " ".join(words) + part
    if len(words) == 1 and words[0] in _TOMORROW:
        return f"tomorrow{part}"
    prefix = words[0] if words and words[0] in ("this", "next", "coming", "following") else ""
    rest = words[1:] if prefix else words
    is_next = "next " if prefix in ("next", "following") else ""
    if len(rest) == 1 and (day := _DAY.get(rest[0].rstrip("s"))) is not None:
        return f"{is_next}{day}{part}"
    if rest in (["weekend"], ["weekends"]):
        return f"{is_next}weekend"
    if rest in (["week"], ["month"]) and is_next:
        return f"{is_next}{rest[0]}"
    return None if prefix or part else _calendar_day(words)


def _calendar_day(words: list[str]) -> str | None:
    months = [_MONTH[word] for word in words if word in _MONTH]
    others = [word for word in words if word not in _MONTH]
    if len(words) == 1 and (match := re.fullmatch(r"(\d{1,2})[/.](\d{1,2})", words[0])):
        return _valid(int(match[1]), int(match[2]))
    day = _day_number(others)
    if day is None or not 1 <= day <= 31:
        return None
    if months:
        return _valid(months[0], day) if len(months) == 1 else None
    return f"day {day}"


def _valid(month: int, day: int) -> str | None:
    if not 1 <= month <= 12 or not 1 <= day <= calendar.monthrange(2024, month)[1]:
        return None
    return f"{month}/{day}"


def _day_number(words: list[str]) -> int | None:
    words = [part for word in words for part in word.split("-") if part]
    if len(words) == 1:
        return _ORDINALS.get(words[0], number_of(words[0]))
    if (
        len(words) == 2
        and words[0] in TEN_WORDS
        and words[1] in _ORDINALS
        and _ORDINALS[words[1]] < 10
    ):
        return TEN_WORDS[words[0]] + _ORDINALS[words[1]]
    return None


def read_price(text: str) -> str | None:
    """Returns the key of a price, else ``None``.

    Examples:
        >>> read_price("$10"), read_price("not more than 20 dollars")
        ('$10', 'under $20')
    """
    words = tokenize(text)
    is_money = bool({"$", "dollars", "dollar", "bucks", "usd"} & set(words))
    is_under = bool({"under", "below", "less", "max", "maximum", "most"} & set(words)) or (
        "more" in words and "than" in words
    )
    numbers = [number for word in words if (number := number_of(word)) is not None]
    if len(numbers) != 1 or not (is_money or is_under):
        return None
    return f"{'under ' if is_under else ''}${numbers[0]}"


READERS: dict[Kind, Callable[[str], str | None]] = {
    "time": read_time,
    "date": read_date,
    "count": read_count,
    "price": read_price,
}
"""The reader of each kind of value except ``text``."""


def kind_of(values: Iterable[str]) -> Kind:
    """Returns the kind of quantity of most values of a slot, else ``"text"``.

    Examples:
        >>> kind_of(["7pm", "8:15 pm", "after work"]), kind_of(["98101", "10036"])
        ('time', 'text')
    """
    values = tuple(values)
    orders: tuple[Kind, ...] = ("price", "count", "date", "time")
    for kind in orders:
        # "amc 8" has a number but is not a count.
        longest = 1 if kind == "count" else 5
        read = sum(
            READERS[kind](value) is not None and len(tokenize(value)) <= longest for value in values
        )
        if read > len(values) / 2:
            return kind
    return "text"
