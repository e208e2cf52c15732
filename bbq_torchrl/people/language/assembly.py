"""From a reading to a frame: the values that are named, and the likeliest act and questions."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

import torch

from bbq_torchrl.domains.frames import ANY, NO_MATCH_TEXT, Frame
from bbq_torchrl.people.language.asking import OPENING, Unclear, asked_slot
from bbq_torchrl.people.language.lexicon import Lexicon, Link
from bbq_torchrl.people.language.model import Reading
from bbq_torchrl.people.language.quantities import sure_kind
from bbq_torchrl.people.language.words import (
    ENGLISH,
    POLITE,
    SMALL,
    Span,
    compact,
    spans_of,
    untagged,
)

_SHORT = 4  # words of an answer that may be just a name
_FEW = 8  # words of a text that picks one by a word of it

_PLACES = ("first former 1st 1 one", "second 2nd 2 two", "third 3rd 3", "fourth 4")
_ORDER = {word: at for at, words in enumerate(_PLACES) for word in words.split()}
_ORDER |= {"last": -1, "latter": -1}
_NTH = re.compile(r"\b([1-4]) (?:st|nd|rd|th)(?= one\b)")  # "the 1st one" is no first of June

_NO_CHOICE = {"", "one", "the", "am", "pm", "past"}
"""Words that pick none of a list: "past" is no film at a quarter past four."""

_ANY_OF = [re.compile(pattern) for pattern in ENGLISH["any_of"]]
_CLAUSE = re.compile(r"[^\w' ]")  # a mark that ends a clause
_MAX_BEFORE, _MAX_AFTER = 8, 6  # words
_DENIED_BEFORE, _DENIED_AFTER = (
    [re.compile(pattern.replace("<gap>", ENGLISH["denial_gap"])) for pattern in ENGLISH[name]]
    for name in ("denied_before", "denied_after")
)
_NO = re.compile(ENGLISH["denied_by_no"])
_PAIR, _MARKS = 2, frozenset(",.;!?")  # "no, 1" is no name
_UNTIL = ("by", "until", "till")
_NOT = ("no", "not", "nothing", "isn't", "isnt")
_ALL = re.compile(ENGLISH["all_counted"])
_NO_COUNT = re.compile(ENGLISH["no_count"])


def assemble(
    words: Sequence[str], reading: Reading, question: Frame, lexicon: Lexicon
) -> tuple[Frame, tuple[Unclear, ...], float]:
    """Returns the frame of a reading, the unclear words, and the log-probability of the frame.

    Args:
        words: the words of the sentence.
        reading: the output of the learned parts.
        question: the agent's last act.
        lexicon: the domain's values.
    """
    asked = asked_slot(question)
    if asked is not None and NO_MATCH_TEXT in " ".join(words):
        # Simulated users repeat that the agent found no match.
        return Frame("inform", {asked: NO_MATCH_TEXT}), (), 0.0
    act = lexicon.domain.acts[int(reading.acts.argmax())]
    spans = _whole_names(words, spans_of(reading.tags), lexicon)
    if (choice := chosen(words, question, lexicon)) is not None:
        others = [span for span in spans if span.slot != asked]  # "The second. We are three."
        informs, unclear = values_of(words, others, lexicon)
        informs[question.requests[0]] = choice
        asks = zip(lexicon.domain.slots, reading.requests.tolist(), strict=True)
        requests = tuple(slot for slot, chance in asks if chance > 0.5 and slot not in informs)
        return Frame("inform", informs, requests), unclear, 0.0
    end = next((at for at, word in enumerate(words) if _CLAUSE.fullmatch(word)), len(words))
    first = "" if end > _SHORT or words[end : end + 1] == ["?"] else " ".join(words[:end])
    left = untagged(words, reading.tags)
    is_own = end == len(words) or (
        not {*words[end:]}.isdisjoint(".?") and asked not in [s.slot for s in spans]
    )
    if asked in lexicon.slots and is_own and lexicon.link(asked, first).is_exact:
        # "LA" is the city or the state asked for; so is that of "LA. What is on there?".
        spans = [Span(asked, 0, end), *(span for span in spans if span.start >= end)]
        left[:end] = [""] * end
    if any(left):
        is_bare = act in ("inform", "deny") and not spans  # though it may name something
        for span in lexicon.full_names(left, asked if is_bare else None):
            around = (*words[max(span.start - 1, 0) : span.start], *words[span.end : span.end + 1])
            is_tagged = span.slot in [tagged.slot for tagged in spans]
            is_sure = _is_sure(words, span) and not (
                is_tagged and lexicon.kinds[span.slot] != "text"
            )
            is_named = is_bare or is_sure or "or" in around  # "Seattle or Portland"
            is_named |= span.slot == asked and span.end - span.start > 1  # "it's only me, dear"
            if is_named and not _is_no_count(words, span, lexicon):
                spans.append(span)
        spans.sort(key=lambda span: span.start)
    spans = _all_of_us(words, spans, lexicon)
    if lexicon.kinds.get(asked or "") == "time" and asked not in [span.slot for span in spans]:
        spans = [_as_time(words, span, asked or "", lexicon) for span in spans]
    informs, unclear = values_of(words, spans, lexicon)
    sure = math.log(max(reading.tags_chance, 1e-9)) + math.log(max(1 - reading.foreign, 1e-9))
    pairs = enumerate(zip(words, reading.is_unknown, strict=True))
    new = [at for at, (word, is_new) in pairs if is_new and word not in POLITE]
    can_name = act == "inform" and lexicon.kinds.get(asked or "") == "text"
    if asked and can_name and new and not (informs or unclear) and reading.foreign < 0.5:
        # An answer of unknown words is an unknown name.
        unclear = (Unclear(asked, " ".join(words[new[0] : new[-1] + 1])),)
    frames = _allowed(words, reading, question, lexicon, informs, unclear)
    frame, chance = max(frames, key=lambda item: item[1])
    likelier = torch.cat([reading.requests, reading.dont_care])
    chance += float(torch.maximum(likelier, 1 - likelier).log().sum())
    return frame, unclear, sure + chance


def _whole_names(words: Sequence[str], spans: Sequence[Span], lexicon: Lexicon) -> list[Span]:
    """Returns tagged spans, each in the name that it is a part of: "2 adults and a kid"."""
    spans = [span for span in spans if not _is_no_count(words, span, lexicon)]
    names = lexicon.full_names(words) if spans else []
    sure = [name for name in names if _is_sure(words, name)]
    whole = {
        next((name for name in sure if name.start <= at.start and at.end <= name.end), at)
        for at in spans
    }
    counts = [at for at in whole if lexicon.kinds[at.slot] == "count"]
    if len(counts) > 1:  # "a family of four, with 2 kids"
        whole -= {at for at in counts if words[at.start] == "with"}
    return sorted(whole, key=lambda span: span.start)


def _all_of_us(words: Sequence[str], spans: list[Span], lexicon: Lexicon) -> list[Span]:
    """Returns spans with the one count that is of all, if any: "3 of us, me and the 2 boys"."""
    counts = {
        at for at in (*spans, *lexicon.full_names(words)) if lexicon.kinds[at.slot] == "count"
    }
    whole = [at for at in counts if _ALL.search(" ".join(words[at.start : at.end + 2]))]
    return [at for at in spans if at not in counts] + whole[:1] if whole else spans


def _is_sure(words: Sequence[str], span: Span) -> bool:
    """Returns whether words that name a value are nothing else: "not far", "by the park"."""
    name = words[span.start : span.end]
    is_name = (len(name) > _PAIR or name[0] in _NOT) and _MARKS.isdisjoint(name)
    return is_name or sure_kind(" ".join(name)) is not None


def _is_no_count(words: Sequence[str], span: Span, lexicon: Lexicon) -> bool:
    """Returns whether words are no number of people, as "one of the earlier ones", "3 hours"."""
    own = " ".join(words[span.start : span.end])
    said = " ".join(words[span.start : span.end + _MAX_AFTER])
    is_none = _NO_COUNT.search(own) is not None or _NO_COUNT.match(said) is not None
    is_until = words[span.start - 1] in _UNTIL and span.start > 0
    is_none |= is_until and own != "myself"  # "in bed by ten"
    is_none |= _NO_COUNT.match(" ".join(words[max(span.start - 2, 0) : span.end])) is not None
    return lexicon.kinds[span.slot] == "count" and is_none


def _as_time(words: Sequence[str], span: Span, asked: str, lexicon: Lexicon) -> Span:
    """Returns a bare number as the hour that was asked for: "10. it's for two", "about 7"."""
    is_first = span.start == 0 or words[span.start - 1] in ("like", "about", "around", "say")
    is_hour = lexicon.kinds[span.slot] == "count" and words[span.start].isdigit() and is_first
    nouns = {"of", *lexicon.phrases.slots[span.slot].nouns}
    is_bare = nouns.isdisjoint(words[span.start : span.end + 1])
    return Span(asked, span.start, span.end) if is_hour and is_bare else span


def chosen(words: Sequence[str], question: Frame, lexicon: Lexicon) -> str | None:
    """Returns the offered value that a short answer picks: "the second", "the later one".

    Args:
        words: the words of the answer.
        question: the agent's last act, with the offered values in its ``choices``.
        lexicon: the domain's values.
    """
    if not question.choices:
        return None
    slot, choices = question.requests[0], question.choices
    spans = [span for span in lexicon.full_names(words, slot) if span.slot == slot]
    named = [" ".join(words[s.start : s.end]) for s in spans if not is_denied(words, *s[1:])]
    keys = {lexicon.key(slot, value) for name in named for value in lexicon.link(slot, name).values}
    own = [value for value in choices if lexicon.key(slot, value) in keys]
    if len(own) == 1:  # "the 3:15 one, we can have lunch first"
        return own[0]
    words = _NTH.sub(lambda found: _PLACES[int(found[1]) - 1].split()[0], " ".join(words)).split()
    clocks = {lexicon.key(slot, value)[-5:]: value for value in choices}
    pairs = [*pairwise(words)]
    ends = {after for word, after in pairs if word in ("the", "that", "at")}
    ends |= {word for word, after in pairs if after in ("one", "1")}
    # Only keys such as "at 19:30" and "after 18:00" can be ordered.
    if lexicon.kinds.get(slot) == "time" and all(clock[2:3] == ":" for clock in clocks):
        if ends & {"late", "later", "latest"}:  # not "anything later?"
            return clocks[max(clocks)]
        if ends & {"early", "earlier", "earliest"}:
            return clocks[min(clocks)]
    # Words that one choice has more of than the others: "the downtown one".
    said = {compact(word) for word in words if word not in SMALL} - _NO_CHOICE
    shared = {value: len(said & {*map(compact, value.split())}) for value in choices}
    most = max(shared.values())
    best = [value for value in choices if shared[value] == most]
    # In a longer text one word is not enough, but for "what times are at the Southgate?".
    is_named = most > 1 or len(words) <= _FEW or 2 * most >= len(best[0].split())
    is_named |= not (ends & said).isdisjoint(map(compact, best[0].split()))
    if most and len(best) == 1 and is_named:
        return best[0]
    for word in words:
        at = _ORDER.get(word)
        if word == "one" and not {"number", "option"} & set(words) and len(words) > 1:
            continue  # "not that one"
        names = lexicon.full_names(words) if word.isdigit() else ()
        if names and (lexicon.kinds.get(slot) != "text" or len(words) > 1):
            continue  # "2 pm", "Inside Out 2"
        if at is not None and at < len(choices) and (len(word) > 3 or len(words) <= 3):
            return choices[at]
    return None


def is_denied(words: Sequence[str], start: int, end: int) -> bool:
    """Returns whether the words around a name reject it.

    Before a number, a "no" retracts what was said before.

    Args:
        words: the words of the sentence.
        start: the first word of the name.
        end: the word after its last.
    """
    before = _CLAUSE.split(" ".join(words[max(start - _MAX_BEFORE, 0) : start]))[-1].strip()
    after = _CLAUSE.split(" ".join(words[end : end + _MAX_AFTER]))[0].strip()
    if words[end - 1].endswith("'s"):
        after = f"'s {after}"  # "Friday's no good"
    says_no = not any(map(str.isdigit, "".join(words[start:end])))
    return (
        (says_no and _NO.search(before) is not None)
        or any(pattern.search(before) for pattern in _DENIED_BEFORE)
        or any(pattern.search(after) for pattern in _DENIED_AFTER)
    )


def values_of(
    words: Sequence[str], spans: Sequence[Span], lexicon: Lexicon
) -> tuple[dict[str, str], tuple[Unclear, ...]]:
    """Returns the values by slot, and the unclear words.

    Args:
        words: the words of the sentence.
        spans: the words that name values, in order.
        lexicon: the domain's values.
    """
    wanted: dict[str, list[tuple[str, Link]]] = {}
    denied: dict[str, str] = {}
    for span in spans:
        slot, start, end = _named(words, span, lexicon)
        text, links = " ".join(words[start:end]), wanted.setdefault(slot, [])
        if is_denied(words, start, end):
            denied[slot] = text
        else:
            links.append((text, lexicon.link(slot, text)))
    informs: dict[str, str] = {}
    unclear: list[Unclear] = []
    for slot, links in wanted.items():
        if not links:
            unclear.append(Unclear(slot, denied[slot], is_denied=True))
            continue
        known = [link for _, link in links if link.values]
        if "or" not in words:
            known = known[-1:]  # "Friday, no wait, Saturday"
        keys = {lexicon.key(slot, value): value for link in known for value in link.values}
        if len(keys) == 1:
            (informs[slot],) = keys.values()
        else:
            unclear.append(Unclear(slot, links[-1][0], tuple(keys.values())))
    return informs, tuple(unclear)


def _named(words: Sequence[str], span: Span, lexicon: Lexicon) -> Span:
    """Returns a span with the slot that its words name in full, whatever was tagged."""
    slot, start, end = span
    text = " ".join(words[start:end])
    link = lexicon.link(slot, text)
    is_date = lexicon.kinds[slot] == "date" and not re.search(r"\d", text)
    if is_date and not link.values:  # "zootopia tomorrow"
        for part in lexicon.full_names(words[start:end], slot)[:1]:
            return Span(slot, start + part.start, start + part.end)
    return span if link.score == 1.0 else Span(lexicon.only_slot(text) or slot, start, end)


def _allowed(
    words: Sequence[str],
    reading: Reading,
    question: Frame,
    lexicon: Lexicon,
    informed: dict[str, str],
    unclear: tuple[Unclear, ...],
) -> Iterator[tuple[Frame, float]]:
    """Yields the likeliest frame of each act that the labeling guide allows.

    With it comes its log-probability, less that of the likelier outcome for each slot.
    """
    domain = lexicon.domain
    asks = dict(zip(domain.slots, reading.requests.tolist(), strict=True))
    cares = dict(zip(domain.slots, reading.dont_care.tolist(), strict=True))
    requests = tuple(slot for slot, chance in asks.items() if chance > 0.5)
    denied = {one.slot for one in unclear if one.is_denied}
    open_ = [slot for slot in lexicon.slots if slot not in informed and slot not in denied]
    free = {slot: ANY for slot in open_ if cares[slot] > 0.5}
    asked = asked_slot(question)
    if asked in free and (slot := _named_as_free(words, asked, lexicon)) in open_:
        free = {slot: ANY}
    is_offer = domain.complete_slot in question.informs
    may_ask = {"deny", "closing", *(["thanks"] if is_offer else [])}
    likely = max((slot for slot in asks if slot not in informed), key=lambda slot: asks[slot])
    forced = 0.0 if requests else _odds(asks[likely])
    unasked = sum(_odds(asks[slot]) for slot in requests)
    for act, chance in zip(domain.acts, reading.acts.tolist(), strict=True):
        if act == "request":
            yield Frame(act, informed | free, requests or (likely,)), chance + forced
        elif act == "inform" and requests and question == OPENING:
            continue  # Asking is what it does first.
        elif act == "inform":
            yield Frame(act, informed | free, requests), chance
        elif act == "confirm_question":
            yield Frame(act, informed | free), chance - unasked
        elif not (informed or unclear):
            asks_too = act in may_ask
            yield Frame(act, free, requests if asks_too else ()), chance - unasked * (not asks_too)


def _named_as_free(words: Sequence[str], asked: str, lexicon: Lexicon) -> str | None:
    """Returns the slot of "any time is fine" or "the day does not matter", if not the one asked."""
    text, own = " ".join(words), lexicon.phrases.slots[asked]
    nouns = {found[1] for pattern in _ANY_OF for found in pattern.finditer(text)}
    nouns -= {*own.nouns, *own.name.split()}
    named = (s for s in lexicon.slots if not nouns.isdisjoint(lexicon.phrases.slots[s].nouns))
    return next(named, None)


def _odds(chance: float) -> float:
    """Returns the log-odds of a probability."""
    chance = min(max(chance, 1e-4), 1 - 1e-4)
    return math.log(chance / (1 - chance))
