"""Variants of text: clocks, dates, short names, words for numbers, typos, slang and filler."""

from __future__ import annotations

import calendar
import random
import re
from collections.abc import Sequence
from functools import cache

from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.quantities import ORDINALS, TENS, UNITS
from bbq_torchrl.people.language.words import ENGLISH, OUTSIDE, compact, pairs, word_set

_MATES = ENGLISH["mates"].split()


class Paraphraser:
    """Writes values as people do.

    Args:
        lexicon: the values; a variant is used only if it is read as the same value.
    """

    def __init__(self, lexicon: Lexicon) -> None:
        self._lexicon = lexicon
        self._is_read = cache(self._reads)
        self._makers = {
            "time": self._time,
            "date": self._date,
            "count": self._count,
            "price": self._price,
            "text": self._name,
        }

    def __call__(self, slot: str, value: str, rng: random.Random) -> str:
        """Returns one way to write the value."""
        if rng.random() < 0.45:
            return value
        written = self._makers[self._lexicon.kinds.get(slot, "text")](slot, value, rng)
        return written if written and self._is_read(slot, value, written) else value

    def _reads(self, slot: str, value: str, written: str) -> bool:
        """Returns whether a variant is read as the value, and as no other slot's value."""
        found = self._lexicon.link(slot, written).values
        return (
            len(found) == 1
            and self._lexicon.key(slot, found[0]) == self._lexicon.key(slot, value)
            and self._lexicon.only_slot(written) in (None, slot)
        )

    def _alias(self, slot: str, value: str, rng: random.Random) -> str:
        for main, others in self._lexicon.phrases.slots[slot].aliases.items():
            if compact(value) in (compact(main), *map(compact, others)):
                return rng.choice((main, *others))
        return ""

    def _name(self, slot: str, value: str, rng: random.Random) -> str:
        if rng.random() < 0.4 and (alias := self._alias(slot, value, rng)):
            return alias
        words = value.split()
        choice = rng.random()
        if ":" in value and choice < 0.4:
            return value.split(":")[0]
        if choice < 0.55 and len(words) > 1:
            return " ".join(words[: rng.randint(1, len(words) - 1)]).rstrip(":-&")
        if choice < 0.65 and len(words) > 2:
            out = rng.randrange(len(words))
            return " ".join(word for index, word in enumerate(words) if index != out)
        if choice < 0.75 and words[0] in ("the", "a"):
            return " ".join(words[1:])
        if choice < 0.85 and len(words) > 2 and words[-1].isdecimal():
            return f"{words[0]} {rng.choice(('of', 'in', 'at'))} {' '.join(words[1:-1])}"
        return re.sub(r"[^\w\s$&%]", rng.choice(("", " ")), value)

    def _time(self, slot: str, value: str, rng: random.Random) -> str:
        relation, _, clock = self._lexicon.key(slot, value).partition(" ")
        if not re.fullmatch(r"\d\d:\d\d", clock):
            return self._alias(slot, value, rng)
        hour, minute = int(clock[:2]), int(clock[3:])
        short = hour % 12 or 12
        meridian = rng.choice(ENGLISH["meridian"]["am" if hour < 12 else "pm"])
        part = "morning" if hour < 12 else "afternoon" if hour < 17 else "evening"
        parts: dict[str, str | int] = {
            "hour": hour,
            "minute": minute,
            "short": short,
            "word": UNITS[short],
            "spelled": _spell(minute),
            "meridian": meridian,
            "meridian_word": meridian.strip(),
            "part": rng.choice(("", "", f"in the {part}")),
            "dot": rng.choice(":::."),
            "mark": rng.choice(".h:"),
        }
        ways = ENGLISH["times"] + ENGLISH["minutes" if minute else "full_hours"]
        if (quarter := ENGLISH["quarters"].get(minute)) is not None:
            named = short if minute < 45 else short % 12 + 1
            ways += [f"{quarter} {rng.choice((str(named), UNITS[named]))} {{part}}"] * 4
        if minute in (5, 10, 20, 25):
            ways.append("{spelled} past {word}")
        if minute in (35, 40, 50, 55):
            ways.append(f"{_spell(60 - minute)} to {UNITS[short % 12 + 1]}")
        written = rng.choice(ways).format(**parts).strip()
        if relation in ENGLISH["before_times"]:
            written = f"{rng.choice(ENGLISH['before_times'][relation])} {written}"
        return written

    def _date(self, slot: str, value: str, rng: random.Random) -> str:
        key = self._lexicon.key(slot, value)
        if rng.random() < 0.3 and (alias := self._alias(slot, value, rng)):
            return alias
        if match := re.fullmatch(r"(\d+)/(\d+)", key):
            month, day = int(match[1]), int(match[2])
            names = (calendar.month_name[month], calendar.month_abbr[month])
            name = rng.choice(names).lower()
            nth = rng.choice((str(day), f"{day}{_suffix(day)}", _ordinal(day)))
            parts = {"name": name, "nth": nth, "month": month, "day": day}
            return rng.choice(ENGLISH["dates"]).format(**parts)
        if match := re.fullmatch(r"day (\d+)", key):
            day = int(match[1])
            parts = {"day": day, "nth": f"{day}{_suffix(day)}", "ordinal": _ordinal(day)}
            return rng.choice(ENGLISH["days_of_a_month"]).format(**parts)
        words = key.split()
        for index, word in enumerate(words):
            if word.capitalize() in calendar.day_name and rng.random() < 0.4:
                words[index] = rng.choice((word[:3], word[:4].rstrip("n"), word))
            elif word == "tomorrow":
                words[index] = rng.choice(ENGLISH["tomorrow"])
        if key == "today night":
            return rng.choice(ENGLISH["today_night"])
        if key.startswith("today "):
            return rng.choice(ENGLISH["today"]).format(part=words[1])
        written = " ".join(words)
        if len(words) == 2 and words[1] in ("night", "evening", "afternoon", "morning"):
            written = rng.choice(ENGLISH["parts_of_a_day"]).format(day=words[0], part=words[1])
        if len(words) == 1 and rng.random() < 0.4:
            written = rng.choice(ENGLISH["one_day"]).format(day=written)
        return rng.choice(ENGLISH["weekend"]) if key == "weekend" else written

    def _count(self, slot: str, value: str, rng: random.Random) -> str:
        key = self._lexicon.key(slot, value)
        if not key.isdecimal() or int(key) > 19:
            return self._alias(slot, value, rng)
        number = int(key)
        mate = rng.choice(_MATES)
        ways = [str(number), UNITS[number]] * 2
        if slot not in self._lexicon.domain.free_slots:  # free slots count people: "me and my wife"
            return rng.choice(ways)
        some = rng.choice((str(number - 1), UNITS[number - 1])) if number > 2 else ""
        ways += ENGLISH["counts"].get(number if number <= 2 else "more", [])
        return rng.choice(ways).format(mate=mate, some=some)

    def _price(self, slot: str, value: str, rng: random.Random) -> str:
        key = self._lexicon.key(slot, value)
        match = re.fullmatch(r"(under )?\$(\d+)", key)
        if match is None:
            return self._alias(slot, value, rng)
        money = rng.choice(ENGLISH["prices"]).format(number=match[2])
        return f"{rng.choice(ENGLISH['most'])} {money}" if match[1] else money


def _spell(number: int) -> str:
    if number < 20:
        return f"oh {UNITS[number]}" if number < 10 and number != 5 else UNITS[number]
    tens, unit = divmod(number, 10)
    return f"{TENS[10 * tens]} {UNITS[unit]}" if unit else TENS[10 * tens]


def _suffix(day: int) -> str:
    return "th" if 10 < day < 20 else {1: "st", 2: "nd", 3: "rd"}.get(day % 10, "th")


def _ordinal(day: int) -> str:
    if day <= 20:
        return ORDINALS[day - 1]
    return "thirtieth" if day == 30 else f"{TENS[day // 10 * 10]}-{ORDINALS[day % 10 - 1]}"


Tagged = list[tuple[str, str]]
"""Words, each with its tag."""

_KEYS = pairs("keys")
_SLANG = pairs("slang")
DROPPED = word_set("dropped")
_SWAPPED = {word: others.split(",") for word, others in pairs("swapped").items()}


def typo(word: str, rng: random.Random) -> str:
    """Returns the word with one typo; very short words are unchanged."""
    if len(word) < 3 or not word.isalpha():
        return word
    at = rng.randrange(1, len(word))
    kind = rng.randrange(4)
    if kind == 0:
        return word[:at] + word[at + 1 :]
    if kind == 1:
        return word[: at - 1] + word[at] + word[at - 1] + word[at + 1 :]
    if kind == 2:
        return word[:at] + word[at] + word[at:]
    return word[:at] + rng.choice(_KEYS.get(word[at].lower(), word[at])) + word[at + 1 :]


def with_typos(words: Sequence[str], share: float, rng: random.Random) -> list[str]:
    """Returns the words, each with a typo with probability ``share``."""
    return [typo(word, rng) if rng.random() < share else word for word in words]


def slangy(tagged: Tagged, rng: random.Random) -> Tagged:
    """Returns a sentence in which some words are written as in text messages."""
    share = rng.choice((0.2, 0.5))
    return [
        (_SLANG.get(word, word) if tag == OUTSIDE and rng.random() < share else word, tag)
        for word, tag in tagged
    ]


def as_second_language(tagged: Tagged, rng: random.Random) -> Tagged:
    """Returns a sentence with some small words dropped, swapped or added."""
    kept = []
    for word, tag in tagged:
        if tag == OUTSIDE and word in DROPPED and rng.random() < 0.3:
            continue
        if tag == OUTSIDE and word in _SWAPPED and rng.random() < 0.2:
            word = rng.choice(_SWAPPED[word])
        if tag == OUTSIDE and rng.random() < 0.02:
            kept.append(("the", OUTSIDE))
        kept.append((word, tag))
    return kept or tagged
