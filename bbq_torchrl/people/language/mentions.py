"""The values that a sentence names: linked to the domain's, of several the one that is meant."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.people.language.asking import Unclear, asked_slot
from bbq_torchrl.people.language.quantities import DAY_WORDS, MONTH_WORDS, ORDINAL_WORDS, PART_WORDS
from bbq_torchrl.people.language.tagger import spans_of
from bbq_torchrl.people.language.words import COUNT_WORDS, NUMBER_WORDS, word_set

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.domains.frames import Frame
    from bbq_torchrl.people.language.lexicon import Lexicon, Link
    from bbq_torchrl.people.language.model import Reading

_FAIR = 0.85  # how well words must fit a name to be taken for it

LONGEST = 8
"""The most words of a name that is looked for."""

SHORT = 4
"""The most words of an answer that may be no more than a name."""

_CORRECTS = word_set("corrects")
_CONCLUDES = word_set("concludes")
_REASONS = frozenset(("since", "because", "although", "though", "unless", "cause", "cuz", "as"))
_NOT = frozenset(("not", "isn't", "isnt", "except", "anything"))
_QUANTITY_WORDS = DAY_WORDS | MONTH_WORDS | NUMBER_WORDS | ORDINAL_WORDS | PART_WORDS
_LIKELY = 0.85
_LEAST = 0.4


class _Mention(NamedTuple):
    """Words that name a value of a slot, and what they were found to mean."""

    text: str
    link: Link
    is_denied: bool = False


def values_of(
    words: Sequence[str], reading: Reading, question: Frame, lexicon: Lexicon
) -> tuple[dict[str, str], tuple[Unclear, ...]]:
    """Returns slot to value, and what is unclear.

    Args:
        words: of the sentence.
        reading: what the learned parts say.
        question: the agent's last act.
        lexicon: the domain's values.
    """
    asked = asked_slot(question)
    found: dict[str, list[_Mention]] = {}
    first: dict[str, int] = {}
    concluded: set[str] = set()
    for slot, start, end in spans_of(reading.tags):
        text = " ".join(words[start:end])
        if lexicon.kinds[slot] == "count":
            start, end = _company(slot, words, start, end, lexicon)
            text = " ".join(words[start:end])
        link = lexicon.link(slot, text)
        if not link.values and (other := lexicon.only_slot(text)) is not None:
            slot, link = other, lexicon.link(other, text)
        parts = [(text, link)] if link.values else _within(slot, words[start:end], lexicon)
        if not link.values and lexicon.kinds[slot] != "text" and not _is_quantity(words[start:end]):
            continue  # No number, day or clock in it: a word that only stood where one could.
        if lexicon.kinds[slot] == "text" and link.score < 1.0:
            inside = _within(slot, words[start:end], lexicon)
            if exact := [part for part in inside if part[1].score == 1.0]:
                parts = exact  # "one drama"
            elif slot != asked and min(reading.each_chance[start:end]) < (
                _LIKELY if end - start == 1 or link.score < _FAIR else _LEAST
            ):
                continue  # Words that are no more than like a name are often none.
        is_denied = not _NOT.isdisjoint(words[max(0, start - 2) : start])
        if slot in first and not _CONCLUDES.isdisjoint(words[first[slot] : start]):
            concluded.add(slot)
        elif slot in first and not _REASONS.isdisjoint(words[first[slot] : start]):
            continue  # "Thursday night, since Friday is a holiday"
        first.setdefault(slot, end)
        mentions = found.setdefault(slot, [])
        mentions += [_Mention(part, link, is_denied) for part, link in parts]
        if (other_name := _or(slot, words, start, end, lexicon)) is not None:
            mentions.append(_Mention(*other_name))
    corrects = not _CORRECTS.isdisjoint(words)
    informs: dict[str, str] = {}
    unclear: list[Unclear] = []
    for slot, mentions in found.items():
        known = [mention for mention in mentions if mention.link.values]
        if len(known) > 1 and (corrects or slot in concluded):
            known = ([mention for mention in known if not mention.is_denied] or known)[-1:]
        if any(mention.link.is_exact for mention in known):
            # Beside a name in full, words that are no more than like one are none.
            known = [mention for mention in known if mention.link.score == 1.0]
        if not known:
            unclear.append(Unclear(slot, mentions[-1].text))
            continue
        keys = {lexicon.key(slot, value): value for one in known for value in one.link.values}
        if len(keys) > 1 and slot in question.informs:
            # "Tulsa? I live in Tucson": what the agent has said is repeated to be denied.
            keys.pop(lexicon.key(slot, question.informs[slot]), None)
        if len(keys) == 1:
            (informs[slot],) = keys.values()
        else:
            unclear.append(Unclear(slot, mentions[-1].text, tuple(keys.values())))
    return informs, tuple(unclear)


def _company(
    slot: str, words: Sequence[str], start: int, end: int, lexicon: Lexicon
) -> tuple[int, int]:
    """Returns where the whole of a number of people stands: "with my two" brothers is three."""
    first, last = start, end
    while first > 0 and words[first - 1] in COUNT_WORDS:
        first -= 1
    while last < len(words) and words[last] in COUNT_WORDS:
        last += 1
    for at in range(first, start + 1):
        for stop in range(last, end - 1, -1):
            if len(lexicon.link(slot, " ".join(words[at:stop])).values) == 1:
                return at, stop
    return start, end


def _or(
    slot: str, words: Sequence[str], start: int, end: int, lexicon: Lexicon
) -> tuple[str, Link] | None:
    """Returns the other name of "this or that", of which one may not have been tagged."""
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
    """Returns whether words have a number, a day, a month or a part of the day."""
    return any(any(map(str.isdigit, word)) or word in _QUANTITY_WORDS for word in words)


def _within(slot: str, words: Sequence[str], lexicon: Lexicon) -> list[tuple[str, Link]]:
    """Returns names inside of words that are none as a whole, the longest from left to right."""
    found = []
    at = 0
    has_month = not MONTH_WORDS.isdisjoint(words)
    while at < len(words):
        for end in range(min(len(words), at + LONGEST), at, -1):
            text = " ".join(words[at:end])
            # A day that its month does not have is no day of another month.
            if has_month and re.search(r"\d", text) and MONTH_WORDS.isdisjoint(words[at:end]):
                continue
            link = lexicon.link(slot, text)
            if len(link.values) == 1 and link.score >= _FAIR:
                found.append((text, link))
                at = end
                break
        else:
            at += 1
    return found or [(" ".join(words), lexicon.link(slot, " ".join(words)))]
