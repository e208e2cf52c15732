"""Numbers of people that the tagger missed or found only in part."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING

from bbq_torchrl.people.language.asking import OPENING
from bbq_torchrl.people.language.learners import OUTSIDE, Span, spans_of
from bbq_torchrl.people.language.words import (
    COUNT_WORDS,
    ENGLISH,
    NUMBER,
    PARTY,
    SMALL,
    compact,
    number_of,
    word_set,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.domains.frames import Frame
    from bbq_torchrl.people.language.lexicon import Lexicon

_COMPANIONS = word_set("companions") | word_set("companies") | word_set("pairs")
_COMPANION = rf"(?:{'|'.join(sorted(_COMPANIONS))})"
_COUNTS_TOLD = [
    re.compile(pattern.replace("<number>", NUMBER).replace("<companion>", _COMPANION))
    for pattern in ENGLISH["counts_told"]
]


def counted(
    words: Sequence[str], tags: Sequence[str], question: Frame, lexicon: Lexicon
) -> list[str]:
    """Returns the tags, with the counts that the tagger missed.

    These stand before a noun ("2 tickets"), come first ("2 dune") or are in a phrase for the number
    of people ("my wife and I", "for two", "2 adults and a child"). A number after "at" is an hour.

    Args:
        words: the words of the sentence.
        tags: the tagger's tag of each word.
        question: the agent's last act.
        lexicon: the domain's values.
    """
    found = _with_hours(words, tags, lexicon)
    counts = [slot for slot in lexicon.slots if lexicon.kinds[slot] == "count"]
    for slot in counts:
        nouns = set(lexicon.phrases.slots[slot].nouns) - SMALL
        for at, (word, noun) in enumerate(pairwise(words)):
            is_open = found[at] == OUTSIDE and noun in nouns and slot not in found
            if is_open and lexicon.link(slot, word).is_exact:
                found[at] = slot
    main, text = lexicon.counted, " ".join(words)
    if main is not None and (party := PARTY.search(text)) is not None:
        start, end = _place(text, party.span())
        found[start:end] = [main] * (end - start)
    first, *_ = spans_of(found) or [Span("", 1, 1)]
    own = " ".join(words[: first.end])
    if first.slot in counts:
        is_named = not set(words[1:2]).isdisjoint(lexicon.phrases.slots[first.slot].nouns)
    else:
        is_named = first.start == 0 and lexicon.link(first.slot, own).is_exact
    is_open = question == OPENING and found[1:2] != [OUTSIDE] and main not in found
    if main is not None and is_open and not is_named and lexicon.link(main, words[0]).is_exact:
        found[0] = main
    if main is not None and main not in found:
        for start, end in _told(words):
            is_open = {*found[start:end]} == {OUTSIDE}
            if is_open and lexicon.link(main, " ".join(words[start:end])).is_exact:
                found[start:end] = [main] * (end - start)
                break
    return found


def _with_hours(words: Sequence[str], tags: Sequence[str], lexicon: Lexicon) -> list[str]:
    """Returns the tags; a number that ends a phrase after "at" is an hour: "a ticket at 8"."""
    found = list(tags)
    slot = next((slot for slot, kind in lexicon.kinds.items() if kind == "time"), None)
    for at, (before, word) in enumerate(pairwise(words), 1):
        after = words[at + 1] if at + 1 < len(words) else "."
        ends = after in SMALL or not compact(after) or tags[at + 1] != OUTSIDE
        is_hour = before == "at" and ends and 1 <= (number_of(word) or 0) <= 12
        if slot and is_hour and (tags[at] == OUTSIDE or lexicon.kinds.get(tags[at]) == "count"):
            found[at] = slot
    return found


def _told(words: Sequence[str]) -> list[tuple[int, int]]:
    """Returns the start and the end of each phrase for a number of people, in words."""
    text = " ".join(words)
    matches = filter(None, (pattern.search(text) for pattern in _COUNTS_TOLD))
    return [_place(text, match.span(match.lastindex or 0)) for match in matches]


def _place(text: str, span: tuple[int, int]) -> tuple[int, int]:
    """Returns the first word of a span of letters, and the word after its last."""
    return text[: span[0]].count(" "), text[: span[1]].count(" ") + 1


def company(
    slot: str, words: Sequence[str], start: int, end: int, lexicon: Lexicon
) -> tuple[int, int]:
    """Returns the full extent of a number of people: "with my two" brothers is three.

    Args:
        slot: the slot of the number.
        words: the words of the sentence.
        start: the first tagged word.
        end: the word after the last tagged one.
        lexicon: the domain's values.
    """
    first, last = start, end
    while first > 0 and words[first - 1] in COUNT_WORDS:
        first -= 1
    while last < len(words) and words[last] in COUNT_WORDS:
        last += 1
    for at in range(first, start + 1):
        for stop in range(last, end - 1, -1):
            if words[at] != "of" and len(lexicon.link(slot, " ".join(words[at:stop])).values) == 1:
                return at, stop
    return start, end
