"""From a reading to a frame: short answers, and the most likely act and questions."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

from bbq_torchrl.domains.frames import ANY, NO_MATCH_TEXT, Frame
from bbq_torchrl.people.language.asking import OPENING, Unclear, asked_slot
from bbq_torchrl.people.language.learners import OUTSIDE
from bbq_torchrl.people.language.mentions import LONGEST, SHORT, values_of
from bbq_torchrl.people.language.party_size import counted
from bbq_torchrl.people.language.words import (
    COUNT_WORDS,
    ENGLISH,
    NUMBER_WORDS,
    POLITE,
    compact,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.people.language.lexicon import Lexicon
    from bbq_torchrl.people.language.model import Reading

_PLACES = ("first former 1st 1 one", "second 2nd 2 two", "third 3rd 3", "fourth 4")
_ORDER = {word: at for at, words in enumerate(_PLACES) for word in words.split()}
_ORDER |= {"last": -1, "latter": -1}
_COUNTS = NUMBER_WORDS | frozenset("me i with alone myself couple pair both dozen".split())
_SURE = 0.95
_ALSO = 0.7  # "what is there in the evening?" tells the time and asks for it
_RATHER = 0.1
_FAINT = 0.3
_FOREIGN = 0.5
_PLAINLY = math.log(0.75)
_LEAST_LETTERS = 4
_NAME = 5  # words of an answer that names no known value
_ABOUT_VALUES = ("inform", "request", "confirm_question")
_NOT = frozenset(("not", "no", "except"))
_ANY = frozenset(("any", "anything", "whatever", "either"))
_ENDS = frozenset((".", "!", "please", "really"))
_ANY_OF = [re.compile(pattern.replace("<name>", "(.+?)")) for pattern in ENGLISH["any_of"]]
_YES = frozenset("yes yeah yep yup right correct sure exactly ok okay indeed true y".split())


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
    text = " ".join(words)
    named = [v for v in choices if re.search(rf"(^|\W){re.escape(v.lower())}(\W|$)", text)]
    if len(named) == 1:
        return named[0]
    clocks = {lexicon.key(slot, value)[-5:]: value for value in choices}
    # Only keys such as "at 19:30" and "after 18:00" can be ordered.
    if lexicon.kinds.get(slot) == "time" and all(clock[2:3] == ":" for clock in clocks):
        if "later" in words or "latest" in words:
            return clocks[max(clocks)]
        if "earlier" in words or "earliest" in words:
            return clocks[min(clocks)]
    # Words that some choices have and others do not: "the downtown one".
    own = {value: {compact(part) for part in value.split()} for value in choices}
    said = {compact(word) for word in words} - {"one", "the"}
    hits = {value: len(parts & said) for value, parts in own.items()}
    best = [value for value, count in hits.items() if count and count == max(hits.values())]
    if len(best) == 1:
        return best[0]
    for word in words:
        at = _ORDER.get(word)
        if word == "one" and not {"number", "option"} & set(words) and len(words) > 1:
            continue  # "not that one"
        if at is not None and at < len(choices) and (len(word) > 3 or len(words) <= 3):
            return choices[at]
    return None


def assemble(
    words: Sequence[str],
    reading: Reading,
    question: Frame,
    lexicon: Lexicon,
) -> tuple[Frame, tuple[Unclear, ...]]:
    """Returns the frame of a reading, and the unclear words.

    Args:
        words: the words of the sentence.
        reading: the output of the learned parts.
        question: the agent's last act.
        lexicon: the domain's values.
    """
    asked = asked_slot(question)
    if asked is not None and NO_MATCH_TEXT in " ".join(words):
        # Simulated users repeat that the agent found no match.
        return Frame("inform", {asked: NO_MATCH_TEXT}), ()
    offered = chosen(words, question, lexicon)
    if asked is not None and offered is not None:
        return Frame("inform", {asked: offered}), ()
    if (free := _any_of(words, question, lexicon)) is not None:
        return Frame("inform", {free: ANY}), ()
    act = lexicon.domain.acts[int(reading.acts.argmax())]
    reading = replace(reading, tags=counted(words, reading.tags, question, lexicon))
    informs, unclear = values_of(words, reading, question, lexicon)
    if reading.foreign > _FOREIGN and not informs:
        return Frame("not_sure" if "not_sure" in lexicon.domain.acts else "inform"), unclear
    is_more = act == "request" and "?" in words  # "comedies?" is more than a name
    is_more |= any(one.is_denied for one in unclear)
    if not is_more and (short := _short_answer(words, reading, asked, lexicon)) is not None:
        return Frame("inform", short), ()
    if not (informs or unclear) and act == "inform" and reading.dont_care.max() < _FAINT:
        informs = _named(words, asked, lexicon)
    if (
        act == "inform"
        and asked in lexicon.slots
        and lexicon.kinds[asked] == "text"
        and not (informs or unclear)
        and len(words) <= _NAME
        and max(reading.dont_care.max(), reading.requests.max()) < _FAINT
        and (name := " ".join(word for word in words if word not in POLITE))
    ):
        return Frame("inform"), (Unclear(asked, name),)
    checked = question.informs if question.act == "confirm_question" else {}
    if checked and not informs and words[0] in _YES and len(words) <= SHORT:
        return Frame("inform", dict(checked)), ()
    is_strange = reading.unknown == 1.0 and not (informs or unclear)
    if is_strange and act not in _ABOUT_VALUES and asked is not None:
        # Unknown words answer the question, so they are an unknown name.
        return Frame("inform"), (Unclear(asked, " ".join(words)),)
    return _decided(words, reading, question, lexicon, informs, unclear), unclear


def _decided(
    words: Sequence[str],
    reading: Reading,
    question: Frame,
    lexicon: Lexicon,
    told: dict[str, str],
    unclear: tuple[Unclear, ...],
) -> Frame:
    """Returns the most likely frame that the labeling guide allows, given the values told."""
    domain = lexicon.domain
    asked = dict(zip(domain.slots, reading.requests.tolist(), strict=True))
    cares = dict(zip(domain.slots, reading.dont_care.tolist(), strict=True))
    requests = tuple(s for s, chance in asked.items() if chance > (_ALSO if s in told else 0.5))
    is_known = reading.unknown < 1.0  # Unknown words carry no information.
    denied = {one.slot for one in unclear if one.is_denied}
    open_ = [slot for slot in lexicon.slots if slot not in told and slot not in denied]
    free = {slot: ANY for slot in open_ if is_known and cares[slot] > 0.5}
    has_content = bool(told or unclear)
    is_offer = domain.complete_slot in question.informs
    likely = max((s for s in asked if s not in told), key=lambda s: asked[s])
    is_repeated = all(
        lexicon.key(s, question.informs.get(s, "")) == lexicon.key(s, told[s]) for s in told
    )
    keeps = {"deny", "closing", *(["thanks"] if is_offer else [])}  # may also ask something
    lost = sum(_odds(asked[slot]) for slot in requests)
    scores = {}
    for act, score in zip(domain.acts, reading.acts.tolist(), strict=True):
        if act == "request":
            score += 0.0 if requests else _odds(asked[likely])
        elif act == "inform":
            tells = has_content or free or score > _PLAINLY  # "I said that already. And where?"
            if requests and (question is OPENING or not tells):
                continue
        elif has_content and act != "confirm_question":
            if act not in ("thanks", "deny") or requests or unclear or not is_repeated:
                continue  # "Nine thirty is fine" alone agrees to nine thirty.
        elif act not in keeps:
            score -= lost
        scores[act] = score
    act = max(scores, key=lambda name: scores[name])
    if act in ("thanks", "deny"):
        told = {}
    if act == "request":
        requests = requests or (likely,)
        if not told and _accepts(words, question, domain.complete_slot):
            act = "thanks"
    elif act != "inform" and act not in keeps:
        requests = ()
    if act == "inform" and question is not OPENING and not (has_content or free or requests):
        # An answer that names nothing does not care, if that is at all likely.
        best = max(lexicon.slots, key=lambda slot: cares[slot])
        if cares[best] > _RATHER and is_known:
            free = {best: ANY}
    return Frame(act, told | free, requests)


def _odds(chance: float) -> float:
    """Returns the log-odds of a probability."""
    chance = min(max(chance, 1e-4), 1 - 1e-4)
    return math.log(chance / (1 - chance))


def _short_answer(
    words: Sequence[str], reading: Reading, slot: str | None, lexicon: Lexicon
) -> dict[str, str] | None:
    """Returns the value of the slot asked for, if the words are exactly one of its names."""
    if slot is None or len(words) > SHORT or words[0] in _NOT:
        return None
    if lexicon.kinds.get(slot) == "count" and (
        "?" in words or not {OUTSIDE, slot}.issuperset(reading.tags)
    ):
        return None  # "four, on saturday" has one number, but says more.
    if slot in lexicon.slots and words[0] in _ANY and len(words) == 1:
        return {slot: ANY}
    text = " ".join(words)
    link = lexicon.link(slot, text) if slot in lexicon.slots else None
    if link is not None and len(link.values) == 1 and link.score >= _SURE:
        return {slot: link.values[0]}
    # "The closest" is not a theater, and its slot is clear without the question.
    other = lexicon.only_slot(text)
    if other is None:
        return None
    values = lexicon.link(other, text).values  # "-3" has the name of 3, but no value
    return {other: values[0]} if values else None


def _any_of(words: Sequence[str], question: Frame, lexicon: Lexicon) -> str | None:
    """Returns the slot of "any theater is fine", "the day does not matter", or an "any time"."""
    text = " ".join(word for word in words if word not in _ENDS)
    said = next((found[1] for pattern in _ANY_OF if (found := pattern.fullmatch(text))), None)
    if said is None:
        return None
    asked = asked_slot(question)
    is_bare = text.partition(" ")[0] in _ANY and text.endswith(said)
    if is_bare and asked is None and question.act != "not_sure":
        return None  # "Any good" after an offer asks something.
    for slot in lexicon.slots:
        phrases, kind = lexicon.phrases.slots[slot], lexicon.kinds[slot]
        if said in (phrases.name, *phrases.nouns) and kind != "count":  # "any tickets"
            # "Any time" answers "When?" about the day, too.
            is_when = is_bare and kind == "time" and lexicon.kinds.get(asked or "") == "date"
            return asked if is_when else slot
    return None


def _named(words: Sequence[str], slot: str | None, lexicon: Lexicon) -> dict[str, str]:
    """Returns the value of the slot asked for if an answer contains its name or number."""
    if slot not in lexicon.slots:
        return {}
    is_count = lexicon.kinds[slot] == "count"
    for size in range(min(len(words), LONGEST), 0, -1):
        for start in range(len(words) - size + 1):
            own = words[start : start + size]
            if is_count and not (COUNT_WORDS.issuperset(own) and _COUNTS.intersection(own)):
                continue  # "depends on my sister" gives no number.
            name = " ".join(own)
            if lexicon.kinds[slot] == "text" and len(name) < _LEAST_LETTERS:
                continue  # "ok" is Oklahoma only if it stands alone.
            link = lexicon.link(slot, name)
            if link.is_exact:
                return {slot: link.values[0]}
    return {}


def _accepts(words: Sequence[str], question: Frame, offer: str) -> bool:
    """Returns whether a booking was offered and the sentence begins by accepting it."""
    is_offered = question.informs.get(offer, NO_MATCH_TEXT) != NO_MATCH_TEXT
    return is_offered and words[0] in _YES
