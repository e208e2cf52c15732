"""The values that a sentence names, linked to the domain's values and disambiguated."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.people.language.asking import Unclear, asked_slot
from bbq_torchrl.people.language.denials import CLAUSE, is_denied
from bbq_torchrl.people.language.learners import OUTSIDE, Span, spans_of
from bbq_torchrl.people.language.party_size import company
from bbq_torchrl.people.language.quantities import DAY_WORDS, MONTH_WORDS, ORDINAL_WORDS, PART_WORDS
from bbq_torchrl.people.language.words import (
    ENGLISH,
    NUMBER_WORDS,
    POLITE,
    compact,
    word_set,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.domains.frames import Frame
    from bbq_torchrl.people.language.lexicon import Lexicon, Link
    from bbq_torchrl.people.language.model import Reading

_FAIR = 0.85  # the least fit at which words count as a name

LONGEST = 8
"""The maximum number of words of a name."""

SHORT = 4
"""The maximum number of words of an answer that may be just a name."""

_CORRECTS = word_set("corrects")
_CONCLUDES = word_set("concludes")
_REASONS = frozenset(("since", "because", "although", "though", "unless", "cause", "cuz", "as"))
_NOT = frozenset(("not", "no", "except"))
_STATES = frozenset(("is", "was", "it's", "its", "that's", "thats"))
_RANGES = ENGLISH["ranges"]
_RANGE = re.compile(rf"(.+?) ({'|'.join(_RANGES)})\b")
_BOUNDS = [
    tuple(text.split())
    for text in ENGLISH["relations"]
    if text.startswith(("no", "after", "before"))
]
_QUANTITY_WORDS = DAY_WORDS | MONTH_WORDS | NUMBER_WORDS | ORDINAL_WORDS | PART_WORDS
_ENDING = ("thanks", "closing")
_PLACES = frozenset("in within around at near".split())
_LIKELY = 0.85
_LEAST = 0.4
_MAYBE = 0.95  # a known name is ignored only if the tagger is this sure
_FAINT = 0.3
_LETTERS = 4


class _Part(NamedTuple):
    """A range of words of a sentence, and the values that they fit."""

    start: int
    end: int
    text: str
    link: Link


class _Mention(NamedTuple):
    """Words that name a value of a slot, and the values that they link to."""

    text: str
    link: Link
    is_denied: bool = False


def values_of(
    words: Sequence[str], reading: Reading, question: Frame, lexicon: Lexicon
) -> tuple[dict[str, str], tuple[Unclear, ...]]:
    """Returns the values by slot, and the unclear words.

    Args:
        words: the words of the sentence.
        reading: the output of the learned parts.
        question: the agent's last act.
        lexicon: the domain's values.
    """
    asked = asked_slot(question)
    found: dict[str, list[_Mention]] = {}
    first: dict[str, int] = {}
    concluded: set[str] = set()
    for slot, start, end in sorted(
        [*spans_of(reading.tags), *_missed(words, reading, asked, lexicon)],
        key=lambda span: span.start,
    ):
        while start + 1 < end and (words[start] in _NOT or not compact(words[start])):
            if lexicon.link(slot, " ".join(words[start:end])).is_exact:
                break  # "not too far"
            start += 1
        text = " ".join(words[start:end])
        if end - start == 1 and "'" in text and len(compact(text)) < _LETTERS:
            continue  # "I'd" is not Idaho
        if lexicon.kinds[slot] == "count":
            start, end = company(slot, words, start, end, lexicon)
            text = " ".join(words[start:end])
        ranged = None
        if lexicon.kinds[slot] != "text":
            ranged = _RANGE.match(" ".join(words[start : end + 3]))
        is_range = ranged is not None
        if ranged is not None and len(ranged[0].split()) >= end - start:
            text = f"{_RANGES[ranged[2]]} {ranged[1]}"
        elif lexicon.kinds[slot] == "time" and (at := _bound(words, start)) is not None:
            start, text, is_range = at, " ".join(words[at:end]), True
        is_praise = text in POLITE and not _STATES.isdisjoint(words[max(start - 1, 0) : start])
        if is_praise and slot != asked and not _is_behind_noun(slot, words, start, lexicon):
            continue  # "I heard it's great"
        link = lexicon.link(slot, text)
        if link.score < 1.0 and not is_range:
            # "In Grand Rapids" is the city, though theaters are named after it.
            start = _without_place(words, start, end, lexicon)
            text = " ".join(words[start:end])
            if (other := lexicon.only_slot(text)) is not None:
                slot, link = other, lexicon.link(other, text)
        parts = [_Part(start, end, text, link)]
        if not link.values and not is_range:
            parts = _within(slot, words, start, end, lexicon)
        if not link.values and lexicon.kinds[slot] != "text" and not _is_quantity(words[start:end]):
            continue  # No number, day or clock in it: just a word in the place of one.
        if lexicon.kinds[slot] == "text" and link.score < 1.0:
            inside = _within(slot, words, start, end, lexicon)
            if exact := [part for part in inside if part.link.score == 1.0]:
                parts = exact  # "one drama"
            elif not link.values:
                parts = [_Part(start, end, text, link)]  # "groundhog day" is not "day one"
            elif slot != asked and min(reading.each_chance[start:end]) < (
                _LIKELY if end - start == 1 or link.score < _FAIR else _LEAST
            ):
                continue  # Words that only resemble a name are often not one.
        if slot in first and not _CONCLUDES.isdisjoint(words[first[slot] : start]):
            concluded.add(slot)
        elif (
            slot in first
            and not _REASONS.isdisjoint(words[first[slot] : start])
            and not all(mention.is_denied for mention in found[slot])
        ):
            continue  # "Thursday night, since Friday is a holiday"
        mentions = found.setdefault(slot, [])
        for part in parts:
            denied = is_denied(words, part.start, part.end, is_first=slot not in first)
            mentions.append(_Mention(part.text, part.link, denied))
            first.setdefault(slot, part.end)
        if (other_name := _or(slot, words, start, end, lexicon)) is not None:
            mentions.append(_Mention(*other_name))
    corrects = not _CORRECTS.isdisjoint(words)
    informs: dict[str, str] = {}
    unclear: list[Unclear] = []
    for slot, mentions in found.items():
        known = [mention for mention in mentions if mention.link.values]
        if len(known) > 1 and (corrects or slot in concluded):
            known = ([mention for mention in known if not mention.is_denied] or known)[-1:]
        if known and all(mention.is_denied for mention in known):
            if slot not in question.informs:
                unclear.append(Unclear(slot, known[-1].text, is_denied=True))
            continue
        known = [mention for mention in known if not mention.is_denied]
        if any(mention.link.is_exact for mention in known):
            # Next to a full name, words that only resemble one are ignored.
            known = [mention for mention in known if mention.link.score == 1.0]
        if not known:
            unclear.append(Unclear(slot, mentions[-1].text))
            continue
        keys = {lexicon.key(slot, value): value for one in known for value in one.link.values}
        if len(keys) > 1 and slot in question.informs:
            # "Tulsa? I live in Tucson": the agent's value is repeated only to deny it.
            keys.pop(lexicon.key(slot, question.informs[slot]), None)
        if len(keys) == 1:
            (informs[slot],) = keys.values()
        else:
            unclear.append(Unclear(slot, mentions[-1].text, tuple(keys.values())))
    return informs, tuple(unclear)


def _missed(
    words: Sequence[str], reading: Reading, asked: str | None, lexicon: Lexicon
) -> list[Span]:
    """Returns the full names that the tagger missed.

    They are denied, or of a slot for which it found no wanted value. A polite word is a name only
    if it is denied and its slot was asked for, or after a noun of it ("critics call it good").
    """
    found: list[Span] = []
    tags = list(reading.tags)
    spans = spans_of(tags)
    named = {slot for slot, start, end in spans if not is_denied(words, start, end)}
    act = lexicon.domain.acts[int(reading.acts.argmax())]
    is_empty = act == "inform" and not spans and reading.dont_care.max() < _FAINT
    maybe = 1.1 if is_empty else _MAYBE  # an inform must name something
    for size in range(min(LONGEST, len(words)), 0, -1):
        for start in range(len(words) - size + 1):
            end = start + size
            name = " ".join(words[start:end])
            is_short = len(name) < _LETTERS and name.isalpha()
            has_edges = compact(words[start]) and compact(words[end - 1])
            if set(tags[start:end]) != {OUTSIDE} or not has_edges:
                continue
            slot = lexicon.only_slot(name)
            if slot is None:
                continue
            is_polite = name in POLITE
            is_about = is_polite and _is_behind_noun(slot, words, start, lexicon)
            denied = (
                not is_short and (slot == asked or not is_polite) and is_denied(words, start, end)
            )
            ends = not CLAUSE.split(" ".join(words[end:]))[0].strip()
            least = maybe if not is_short else _LIKELY if ends else 0.0  # "md", but not "if"
            if size > 1 and act in _ENDING:
                least = 1.1  # "clean theater thats all" must not end a conversation
            is_doubtful = max(reading.each_chance[start:end]) < least and not is_polite
            if denied or ((is_doubtful or is_about) and slot not in named):
                found.append(Span(slot, start, end))
                tags[start:end] = [slot] * size
    return found


def _without_place(words: Sequence[str], start: int, end: int, lexicon: Lexicon) -> int:
    """Returns the start of a single slot's name after "in" or the like; else ``start``."""
    at = start
    while at < end and lexicon.only_slot(" ".join(words[at:end])) is None:
        if words[at] not in _PLACES:
            return start
        at += 1
    return at if at < end else start


def _is_behind_noun(slot: str, words: Sequence[str], start: int, lexicon: Lexicon) -> bool:
    """Returns whether a noun of a slot precedes a word in its clause."""
    before = CLAUSE.split(" ".join(words[:start]))[-1].split()
    return not set(before).isdisjoint(lexicon.phrases.slots[slot].nouns)


def _bound(words: Sequence[str], start: int) -> int | None:
    """Returns the start of "not before", "after" or the like at a time, else ``None``."""
    for phrase in _BOUNDS:
        for at in range(max(start - len(phrase), 0), start + 1):
            if tuple(words[at : at + len(phrase)]) == phrase:
                return at
    return None


def _or(
    slot: str, words: Sequence[str], start: int, end: int, lexicon: Lexicon
) -> tuple[str, Link] | None:
    """Returns the other name of "this or that", which may not have been tagged."""
    for size in range(SHORT, 0, -1):
        for at, own in (
            (end, words[end + 1 : end + 1 + size]),
            (start - 1, words[max(start - 1 - size, 0) : max(start - 1, 0)]),
        ):
            link = lexicon.link(slot, " ".join(own)) if words[at : at + 1] == ["or"] else None
            if link is not None and link.is_exact:
                return " ".join(own), link
    return None


def _is_quantity(words: Sequence[str]) -> bool:
    """Returns whether words contain a number, a day, a month or a part of the day."""
    return any(any(map(str.isdigit, word)) or word in _QUANTITY_WORDS for word in words)


def _within(slot: str, words: Sequence[str], start: int, end: int, lexicon: Lexicon) -> list[_Part]:
    """Returns the longest names, from left to right, in words that are not a name as a whole."""
    found = []
    at = start
    has_month = not MONTH_WORDS.isdisjoint(words[start:end])
    while at < end:
        for stop in range(min(end, at + LONGEST), at, -1):
            text = " ".join(words[at:stop])
            # A day that its month does not have is not a day of another month.
            if has_month and re.search(r"\d", text) and MONTH_WORDS.isdisjoint(words[at:stop]):
                continue
            link = lexicon.link(slot, text)
            if len(link.values) == 1 and link.score >= _FAIR:
                found.append(_Part(at, stop, text, link))
                at = stop
                break
        else:
            at += 1
    text = " ".join(words[start:end])
    return found or [_Part(start, end, text, lexicon.link(slot, text))]
