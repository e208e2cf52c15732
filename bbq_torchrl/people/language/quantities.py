"""Times, dates, prices and kinds of quantity: one canonical key for all ways to say the same.

The same reader makes the keys of a domain's values and of what people type, so the two match. A key
is text: ``"at 19:30"``, ``"friday night"``, ``"3/14"``, ``"2"``, ``"$10"``.
"""

from __future__ import annotations

import calendar
import math
import re
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Literal, get_args

from bbq_torchrl.people.language.words import ENGLISH, pairs, tokenize, word_set

Kind = Literal["text", "time", "date", "count", "price"]
KINDS: tuple[Kind, ...] = get_args(Kind)

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

_COMPANION = (
    rf"(?:(?:my|an?|the) (?:\w+ )?(?:{'|'.join(sorted(_COMPANIONS))})"
    rf"|(?:(?:my|our|the) )?{NUMBER} (?:little ones|{'|'.join(sorted(_COMPANIES))}))"
)
_ME = "(?:i|me|myself)"
_SURE: dict[Kind, re.Pattern[str]] = {
    "count": re.compile(
        rf"{NUMBER} (?:of us|seats?)|(?:an? )?(?:{'|'.join(ENGLISH['groups'].split())}) of {NUMBER}"
        rf"|with (?:(?:my|our) )?{NUMBER} (?:{'|'.join(sorted(_COMPANIES))})"
        rf"|(?:{_COMPANION}|her|him) (?:and|n|&) {_ME}|{_ME} (?:and|n|&) (?:{_COMPANION}|her|him)"
        rf"|{NUMBER} couples|{PARTY.pattern}"
        rf"|(?:i am|i'm|im) alone|(?:going|coming) (?:alone|solo)|(?:by|for) myself"
        rf"|(?:we are|we're) {_MEMBER}"
    ),
    "time": re.compile(
        rf"(?:half|quarter|(?:\w+ - )?{NUMBER}) past {NUMBER}(?: one)?"
        rf"|(?:at )?\d[\d:.]* [ap]\.?m\.?|\d\d?:\d\d|at {NUMBER}|(?:the )?{NUMBER} o'clock"
    ),
}


@lru_cache(maxsize=10_000)
def sure_kind(text: str) -> Kind | None:
    """Returns the kind of a quantity that nothing else can be, else ``None``.

    Examples:
        >>> [sure_kind(text) for text in ("11 am", "my son and i", "4 of us", "at 2", "two")]
        ['time', 'count', 'count', 'time', None]
    """
    return next((kind for kind, pattern in _SURE.items() if pattern.fullmatch(text)), None)


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
    is_company = bool(_COMPANIES & said) or {"little", "ones"} <= said
    if "dozen" in said:
        return 6 if "half" in said else 12 * sum(numbers or [1])
    if numbers:
        is_plus = has_me and not said.isdisjoint(("+", "plus"))
        is_plus |= is_company and (has_me or "with" in said) and "us" not in said
        return numbers[0] * (1 + ("couples" in said)) + is_plus * (
            1 + sum(word in _COMPANIONS for word in words)
        )
    if not said.isdisjoint(("couple", "pair", "both")):
        return 2 + (is_company and has_me)  # "a couple of friends and me"
    if said <= {"just", "me", "i", "and", "n", "her", "him"} and said & {"her", "him"} and has_me:
        return 2
    companions = sum((word in _COMPANIONS) + 2 * (word in _PAIRS) for word in words)
    if companions and (has_me or "with" in said or words[0] == "a"):
        return 1 + companions
    return int(bool(_ALONE & said) or " ".join(words) in ENGLISH["just_me"])


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

_AM = frozenset(("am", "a.m", "a.m."))
_BEFORE_NOON = _AM | {"morning"}
_AFTER_NOON = frozenset(("pm", "p.m", "p.m.", "afternoon", "evening", "night", "tonight"))
SPANS = {
    "at": (0.0, 0.0),
    "around": (-60.0, 60.0),
    "after": (1.0, math.inf),
    "before": (-math.inf, -1.0),
}
"""The minutes from an hour that a relation to it allows."""

_HOURS = {
    "morning": 10,
    "matinee": 14,
    "afternoon": 15,
    "evening": 19,
    "tonight": 19,
    "night": 21,
    "work": 19,
}
_OF_PART = 150  # minutes from the middle of a part of the day: evening is from 4:30 to 9:30 pm
_NIGHT = 240  # minutes: until 4 am it is still the evening
_NAMED_TIMES = {"noon": "12:00", "midday": "12:00", "midnight": "00:00"}
_RELATION = re.compile(
    rf"(?:(?:{'|'.join(ENGLISH['before_relations'].split())}) )*"
    rf"({'|'.join(ENGLISH['relations'])}) (?:(?:about|around) )?"
)
_TENS_AND_UNIT = re.compile(r"\b([2-5]0) ([1-9])(?= (?:past|to|till)\b)")
_CLOCK = re.compile(
    r"(?P<hour>\d{1,2})(?:[:.h]?(?P<minute>\d\d)| (?P<spoken>oh \d|[2-5]0 \d|[1-5]\d))?"
    r"|(?P<before_half>\d{1,2}) (?:a )?half|half (?P<after_half>\d{1,2})"
    r"|(?:a )?(?P<part>half|quarter|\d{1,2})(?: minutes)?"
    r" (?:(?P<past>past|after)|to|till|before) (?P<full>\d{1,2}|noon|midday)"
)


def read_time(text: str) -> str | None:
    """Returns the key of a time of day, else ``None``.

    An hour without am or pm is marked by ``?`` and means the afternoon or evening if both exist.

    Examples:
        >>> [read_time(t) for t in ("7:30 pm", "half past seven", "1930", "after 6pm", "25:99")]
        ['at 19:30', 'at 19:30?', 'at 19:30', 'after 18:00', None]
    """
    line, relation = " ".join(tokenize(text)), "at"
    line = re.sub(r"\b(?:around )?([\w:.]+?) ?-? ?ish\b", r"around \1", line)
    for phrase, name in ENGLISH["ranges"].items():
        if line.endswith(f" {phrase}"):
            relation, line = name, line.removesuffix(phrase)
    line = " ".join(word for word in line.split() if word not in _TIME_FILLERS)
    if found := _RELATION.match(line):
        relation, line = ENGLISH["relations"][found[1]], line[found.end() :]
    words = line.split()
    kept = [word for word in words if word not in _BEFORE_NOON | _AFTER_NOON]
    if len(kept) == 1 and kept[0] in _NAMED_TIMES:
        return f"{relation} {_NAMED_TIMES[kept[0]]}"
    shift = None
    if len(kept) < len(words):
        is_am = _AFTER_NOON.isdisjoint(words) or not _AM.isdisjoint(words)  # "tonight 10:05 am"
        shift = 0 if is_am else 12
        if len(kept) == 2 and _read_clock(kept) is None:
            kept.insert(1, "oh")  # "ten five pm"
    clock = _read_clock(kept)
    if clock is None or clock[0] > 23 or clock[1] > 59 or (clock[0] > 12 and shift == 0):
        return None
    hour, minute, is_sure = clock
    if hour <= 12 and (shift is not None or not is_sure):
        hour, is_sure = hour % 12 + (12 if shift is None else shift), shift is not None
    return f"{relation} {hour:02}:{minute:02}{'' if is_sure else '?'}"


def minutes_of(text: str) -> float:
    """Returns the minutes from midnight of a time of day; NaN of "late at night"."""
    read = (read_time(text) or "").rstrip("?")
    if not read.startswith("at "):
        return math.nan
    hour, minute = read.removeprefix("at ").split(":")
    return 60.0 * int(hour) + int(minute)


def about_minutes(text: str) -> float:
    """Returns the minutes from midnight near a time or a part of the day; NaN of neither.

    Examples:
        >>> [about_minutes(text) / 60 for text in ("at 7 pm", "after 6", "in the evening")]
        [19.0, 19.0, 19.0]
    """
    if read := (read_time(text) or "").rstrip("?"):
        relation, clock = read.split()
        return minutes_of(clock) + {"after": 60, "before": -60}.get(relation, 0)
    return next((60.0 * _HOURS[word] for word in tokenize(text) if word in _HOURS), math.nan)


def span_of(text: str) -> tuple[float, float] | None:
    """Returns the first and the last minute of a vague time; ``None`` of a clock time or neither.

    A time is vague if it is a part of the day, or around, after or before an hour.

    Examples:
        >>> span_of("in the evening"), span_of("after 6pm"), span_of("6:30 pm")
        ((990.0, 1290.0), (1081.0, inf), None)
    """
    relation, _, clock = (read_time(text) or "").rstrip("?").partition(" ")
    if relation == "at":
        return None
    if not clock:
        middle = about_minutes(text)
        return None if math.isnan(middle) else (middle - _OF_PART, middle + _OF_PART)
    hour = of_evening(minutes_of(clock))
    first, last = SPANS[relation]
    return hour + first, hour + last


def of_evening(minutes: float) -> float:
    """Returns the minutes of a time on the day whose evening it ends: midnight is late."""
    return minutes + 1_440 if minutes < _NIGHT else minutes


def day_of(text: str) -> str:
    """Returns the day of a date without the part of the day: "tonight" is today."""
    words = (read_date(text) or text).split()
    return " ".join(word for word in words if word not in {*PART_WORDS, "later"})


def is_on(day: str, of: str) -> bool:
    """Returns whether a date is in another one, as Sunday night is on Sunday and at the weekend."""
    own, whole = day_of(day), day_of(of)
    is_whole = whole == (read_date(of) or of)
    return is_whole and (own == whole or (whole == "weekend" and own in ("saturday", "sunday")))


@lru_cache(maxsize=10_000)
def day_at(date: str, time: str) -> str:
    """Returns a date without its part of the day where a time is not in that.

    Examples:
        >>> [day_at(date, "10:05 am") for date in ("tonight", "friday night", "friday")]
        ['today', 'friday', 'friday']
        >>> [day_at("tonight", time) for time in ("4:15 pm", "6 pm", "11:45 pm")]
        ['today', 'tonight', 'tonight']
    """
    part = next((word for word in (read_date(date) or "").split() if word in PART_WORDS), "")
    first, last = span_of(part) or (-math.inf, math.inf)
    if part == "night":
        first, last = first - 60, math.inf  # a date's night has the whole evening
    minutes = of_evening(minutes_of(time))
    if math.isnan(minutes) or first <= minutes <= last:
        return date
    if day_of(date) == "today":
        return "today"
    return " ".join(word for word in date.split() if word not in PART_WORDS)


def is_at(day: str, values: Iterable[str]) -> bool:
    """Returns whether a time among some values is in the part of the day that a date names.

    Examples:
        >>> [is_at(day, ["4:15 pm", "reno"]) for day in ("tonight", "friday afternoon", "friday")]
        [False, True, False]
    """
    has_part = not {*(read_date(day) or "").split()}.isdisjoint(PART_WORDS)
    times = (value for value in values if sure_kind(value) == "time")
    return has_part and any(day_at(day, time) == day for time in times)


def _read_clock(words: list[str]) -> tuple[int, int, bool] | None:
    """Returns the hour, the minute and whether the clock certainly has 24 hours."""
    line = " ".join(str(_NUMBERS.get(word, word)) for word in words)
    line = _TENS_AND_UNIT.sub(lambda found: str(int(found[1]) + int(found[2])), line)
    # "The quarter past three one"
    found = _CLOCK.fullmatch(line) or _CLOCK.fullmatch(line.removesuffix(" 1"))
    if not line.isascii() or found is None:
        return None
    if found["full"]:
        hour = int(found["full"]) if found["full"].isdigit() else 12
        part = found["part"]
        minutes = {"half": 30, "quarter": 15}.get(part) or int(part)
        if not 0 < minutes < 60 or hour > 24:
            return None
        if not found["past"]:
            hour, minutes = (hour - 1) % 12 or 12, 60 - minutes
        return hour, minutes, False
    if halved := found["before_half"] or found["after_half"]:
        return int(halved), 30, False
    hour, minute = int(found["hour"]), found["minute"] or found["spoken"]
    if minute is None:
        return hour % 24 if hour == 24 else hour, 0, hour in (0, *range(13, 25))
    is_sure = line[0] == "0" or (len(line) == 4 and line.isdecimal())
    return hour, sum(map(int, minute.removeprefix("oh ").split())), is_sure or hour > 12


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
    if len(words) == 2 and words[0] in TEN_WORDS and (unit := _ORDINALS.get(words[1], 10)) < 10:
        return TEN_WORDS[words[0]] + unit
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
