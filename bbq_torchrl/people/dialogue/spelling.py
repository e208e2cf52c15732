"""One spelling for each value, shared by people, agents, goals and records."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import reduce
from itertools import permutations
from math import inf
from typing import TYPE_CHECKING

from bbq_torchrl.domains.values import RESERVED_TEXT, fold
from bbq_torchrl.people.dialogue.completing import completed
from bbq_torchrl.people.language import Unclear
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.quantities import (
    PART_WORDS,
    SPANS,
    about_minutes,
    day_at,
    day_of,
    is_on,
    minutes_of,
    of_evening,
    read_time,
    span_of,
    sure_kind,
)
from bbq_torchrl.people.language.words import tokenize

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from bbq_torchrl.domains import Domain


_RESERVED = frozenset(fold(text) for text in RESERVED_TEXT.values())
_LATER = PART_WORDS - {"morning"} | {"tonight"}
_CLOSE = 0.8  # the score of a name that fits
_PART = re.compile(r"\b(morning|afternoon|evening) (?:show|screening|session|time|slot|one)")
_CLOCK = 4  # words of a time: "half past eleven"


class Spelling:
    """The one spelling that each value of a domain has in a conversation.

    Corpora spell some values in several ways ("7:30pm" and "7:30 pm", "2" and "two"), and a record
    or a goal has one of them. A person who types another means the same.

    Args:
        domain: the domain, with its phrases in its folder; otherwise with the generic phrases.

    Attributes:
        lexicon: the domain's phrases and values.
        domain: the domain, with its records and goals in their most frequent spelling, on the day
            that they are ("tonight at 10:05 am" is today), and in each record what its other values
            determine, as a city its state.
        wholes: for a slot whose values all begin names of another, as a chain a theater's, that
            other.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> domain = movie_domain()
        >>> spelling = Spelling(domain)
        >>> spelling.of({"numberofpeople": "two", "starttime": "2:15pm", "city": "nowhere"})
        {'numberofpeople': '2', 'starttime': '2:15 pm', 'city': 'nowhere'}
    """

    def __init__(self, domain: Domain) -> None:
        self.lexicon = Lexicon(domain)
        goals = (replace(goal, constraints=self._dated(goal.constraints)) for goal in domain.goals)
        records = tuple(map(self._dated, domain.records))
        spelled = replace(domain, records=records, goals=tuple(goals))
        self.domain = replace(spelled, records=completed(spelled))
        self._recorded: dict[str, set[str]] = {}
        for record in self.domain.records:
            for slot in record.keys() - set(domain.free_slots):
                self._recorded.setdefault(slot, set(_RESERVED)).add(fold(record[slot]))
        names = {slot: self.lexicon.values(slot) for slot in self.lexicon.slots}
        self.wholes = {
            slot: whole
            for slot, whole in permutations(names, 2)
            if names[slot] and all(_begins(name, names[whole]) for name in names[slot])
        }

    def of(self, values: Mapping[str, str]) -> dict[str, str]:
        """Returns the values by slot in that spelling; unknown values are unchanged."""
        return {slot: self.lexicon.respell(slot, value) for slot, value in values.items()}

    def _dated(self, values: Mapping[str, str]) -> dict[str, str]:
        """Returns the values in that spelling, with a day for its part that a time is not in."""
        kinds, spelled = self.lexicon.kinds, self.of(values)
        times = [time for slot, time in spelled.items() if kinds.get(slot) == "time"]
        days = {s: reduce(day_at, times, v) for s, v in spelled.items() if kinds.get(s) == "date"}
        return spelled | self.of(days)

    def understood(
        self,
        text: str,
        values: Mapping[str, str],
        informed: Mapping[str, str],
        unclear: Iterable[Unclear] = (),
    ) -> tuple[dict[str, str], tuple[Unclear, ...]]:
        """Returns a person's values as the records have them, and those that are unclear.

        A part of a day that no record has is left out ("Sunday morning"). A time without am or pm
        is the one that the agent has just given, or the only one that a record has. What constrains
        a booking and is in no record is unclear.

        Args:
            text: the person's text.
            values: the values understood, by slot.
            informed: the values of the agent's last act.
            unclear: the unclear values of the text.

        Examples:
            >>> from bbq_torchrl.domains import movie_domain
            >>> spelling = Spelling(movie_domain())
            >>> spelling.understood("at 11:35", {"starttime": "11:35 pm"}, {})
            ({'starttime': '11:35am'}, ())
        """
        found: dict[str, str] = {}
        names = [*unclear]
        if part := _PART.search(text.lower()):  # "evening shows"
            times = (slot for slot, kind in self.lexicon.kinds.items() if kind == "time")
            links = {slot: self.lexicon.link(slot, f"in the {part[1]}") for slot in times}
            named = {s: one.values[0] for s, one in links.items() if one.is_exact}
            is_one = part[0].endswith(" one") and not any(map(str.isdigit, text))  # not 1 pm
            values = {**values, **named} if is_one else {**named, **values}
        words = tokenize(text)
        for slot, value in self.of(values).items():
            place = self.lexicon.place(words, slot, value)
            before = words[place.start - 1 : place.start] if place is not None else []
            if self.lexicon.kinds.get(slot) == "time" and before in (["before"], ["after"]):
                names.append(Unclear(slot, f"{before[0]} {value}"))
                continue
            options = self._options(text, slot, value, informed.get(slot))
            if len(options) == 1 and self._has(slot, options[0]):
                found[slot] = options[0]
            else:
                typed = value if place is None else " ".join(words[place.start : place.stop])
                several = options if len(options) > 1 else self.lexicon.longer(words, slot, typed)
                names.append(Unclear(slot, typed, several))
        return found, tuple(map(self._meant, names))

    def _meant(self, name: Unclear) -> Unclear:
        """Returns an unclear name with the values that it may mean.

        Of a time such as "after 6:30", they are the times of records, the nearest first. What its
        slot does not know may be the name of something else.
        """
        lexicon, slot = self.lexicon, name.slot
        if name.candidates or name.is_denied:
            return name
        read = read_time(name.text) if lexicon.kinds.get(slot) == "time" else None
        parts = [v for v in lexicon.values(slot) if f" {v} " in f" {name.text} "]
        if parts and read is None:  # "afternoon matinee"
            return replace(name, candidates=tuple(parts))
        if read is None:
            # "The Southgate 10" is no number of people.
            others = (other for other in lexicon.slots if lexicon.kinds[other] != "count")
            links = {other: lexicon.link(other, name.text) for other in (slot, *others)}
            slot = max(links, key=lambda other: links[other].score)
            is_close = links[slot].score > _CLOSE
            return replace(name, slot=slot, candidates=links[slot].values) if is_close else name
        relation, clock = read.rstrip("?").split()
        times = [value for value in lexicon.values(slot) if self._has(slot, value)]
        to = of_evening(minutes_of(f"at {clock}"))
        away = {value: of_evening(minutes_of(value)) - to for value in times}
        spans = (SPANS[one] for one in (relation, "around"))
        exact, near = ([v for v in times if low <= away[v] <= high] for low, high in spans)
        # No record has "at 6", but one has "around 6".
        fit = exact or [v for v in times if read_time(v) == f"around {clock}"] or near
        return replace(name, candidates=tuple(sorted(fit, key=lambda value: abs(away[value]))))

    def is_meant(self, slot: str, said: str, own: str) -> bool:
        """Returns whether a record's value is what a person means by another.

        "Around 7" means a time near 7, "in the evening" any time in it.
        """
        key, kind = self.lexicon.key, self.lexicon.kinds.get(slot)
        if kind == "time" and read_time(own):
            first, last = span_of(said) or (inf, inf)
            is_in = first <= of_evening(minutes_of(own)) <= last
            return is_in or about_minutes(said) == about_minutes(own)
        is_next = fold(said) == day_of(own).removeprefix("next ")
        is_day = kind == "date" and (is_next or is_on(own, said))
        is_other = sure_kind(said) not in (None, kind)  # "3 pm" is not three people
        return is_day or (key(slot, own) == key(slot, said) and not is_other)

    def as_in(
        self, record: Mapping[str, str], text: str, values: Mapping[str, str]
    ) -> dict[str, str]:
        """Returns the values of a text, with a record's times where it says neither am nor pm."""
        found = dict(values)
        for slot, value in values.items():
            if slot in record and self._options(text, slot, value, record[slot]) == (record[slot],):
                found[slot] = record[slot]
        return found

    def on_day(self, values: Mapping[str, str], record: Mapping[str, str]) -> dict[str, str]:
        """Returns values with a record's date for a part of its day that its time is in."""
        kinds, found = self.lexicon.kinds, dict(values)
        times = [time for slot, time in record.items() if kinds.get(slot) == "time"]
        for slot, value in values.items():
            is_day = kinds.get(slot) == "date" and day_of(value) == day_of(record.get(slot, ""))
            if is_day and any(day_at(value, time) == value for time in times):
                found[slot] = record[slot]
        return found

    def hours_in(
        self, record: Mapping[str, str], text: str, values: Mapping[str, str]
    ) -> dict[str, str]:
        """Returns values with the hour of a record's time for a bare number: "ok, 5 works"."""
        kinds, found = self.lexicon.kinds, dict(values)
        times = {slot: minutes_of(v) for slot, v in record.items() if kinds.get(slot) == "time"}
        words = {*tokenize(text)}
        counts = {s for s in values if kinds.get(s) == "count" and record.get(s) != values[s]}
        if not words.isdisjoint(("no", "not")):  # "no, for 8"
            counts -= record.keys()
        bare = {*filter(str.isdecimal, words)}
        for slot in counts - {*self.named(text, counts)}:
            for time, minutes in times.items():
                if values[slot] in bare and minutes % 720 == 60 * int(values[slot]):
                    found.pop(slot, None)
                    found[time] = record[time]
        return found

    def besides(self, values: Mapping[str, str], record: Mapping[str, str]) -> dict[str, str]:
        """Returns values without those that are how names of a record begin: "the AMC"."""
        begun = {s for s, w in self.wholes.items() if is_in(values.get(s, ""), record.get(w, ""))}
        return {slot: value for slot, value in values.items() if slot not in begun}

    def is_other(self, values: Mapping[str, str], record: Mapping[str, str]) -> bool:
        """Returns whether a value is how another name than a record's begins: another chain."""
        kept = self.besides(values, record)
        return any(slot in kept and whole in record for slot, whole in self.wholes.items())

    def is_vague_time(self, slot: str, value: str) -> bool:
        """Returns whether a value of a time names no time by the clock: "in the evening"."""
        return self.lexicon.kinds.get(slot) == "time" and read_time(value) is None

    def is_named(self, text: str, values: Mapping[str, str]) -> bool:
        """Returns whether a text names each of some values in full."""
        words, lexicon = tokenize(text), self.lexicon
        places = {slot: lexicon.place(words, slot, value) for slot, value in values.items()}
        return all(
            at is not None and lexicon.link(slot, " ".join(words[at.start : at.stop])).is_exact
            for slot, at in places.items()
        )

    def _has(self, slot: str, value: str) -> bool:
        """Returns whether a record has a value, or the slot constrains no booking."""
        return slot not in self._recorded or fold(value) in self._recorded[slot]

    def _options(self, text: str, slot: str, value: str, informed: str | None) -> tuple[str, ...]:
        """Returns the values that a person may mean by one."""
        lexicon = self.lexicon
        kind, key = lexicon.kinds.get(slot), lexicon.key(slot, value)
        if kind == "date" and not self._has(slot, value):
            day, _, part = key.rpartition(" ")
            return (lexicon.respell(slot, day),) if part in PART_WORDS and day else (value,)
        if kind != "time" or (clock := _before_noon(text, key)) is None:
            return (value,)
        morning = lexicon.respell(slot, clock)
        if slot not in self._recorded or not self._has(slot, morning) or informed == value:
            return (value,)
        is_plain = informed == morning or "morning" in tokenize(text) or not self._has(slot, value)
        return (morning,) if is_plain else (morning, value)

    def named(
        self, text: str, slots: Iterable[str], asked: Collection[str] = ()
    ) -> tuple[str, ...]:
        """Returns the slots for which a text has a noun.

        Args:
            text: the person's text.
            slots: the slots that may be named.
            asked: the slots asked about: their nouns do not name another slot.
        """
        nouns = {slot: set(phrases.nouns) for slot, phrases in self.lexicon.phrases.slots.items()}
        spoken = set().union(*(nouns[slot] for slot in asked))
        words = {word.removesuffix("'s") for word in tokenize(text)}  # "when's it on?"
        return tuple(
            slot for slot in slots if words & (nouns[slot] - (set() if slot in asked else spoken))
        )


def is_in(name: str, other: str) -> bool:
    """Returns whether a name is another, or a part of it."""
    return f" {' '.join(tokenize(name))} " in f" {' '.join(tokenize(other))} "


def _begins(name: str, others: Iterable[str]) -> bool:
    """Returns whether a name is how a longer one begins."""
    return any(other.startswith(f"{name} ") for other in others)


def _before_noon(text: str, key: str) -> str | None:
    """Returns the time in the morning that a text may mean by a time after noon, else ``None``.

    Args:
        text: the person's text.
        key: the canonical key of the time that was understood.
    """
    words = tokenize(text)
    sizes = range(1, _CLOCK + 1)
    reads = {read_time(" ".join(words[at : at + n])) for at in range(len(words)) for n in sizes}
    is_later = not _LATER.isdisjoint(words) and "morning" not in words
    if f"{key}?" not in reads or key in reads or is_later:
        return None
    hour, minute = key.split()[1].split(":")
    return f"{(int(hour) - 12) or 12}:{minute} am" if key.startswith("at ") else None
