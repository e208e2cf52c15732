"""The language of a domain: its phrases, its values, and people's names for them."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from typing import Any

from bbq_torchrl.domains import Domain, build_vocabulary, fold
from bbq_torchrl.domains.values import FIRST_VALUE
from bbq_torchrl.people.language.phrases import load_phrases
from bbq_torchrl.people.language.quantities import READERS, Kind, kind_of, sure_kind
from bbq_torchrl.people.language.words import POLITE, SMALL, Span, compact, pairs, tokenize
from bbq_torchrl.utils.output import needed

_NEGATIVE = re.compile(r"-\s?\d")
_CLOSE = 0.045
_LEAST = 0.6
_MAX_TIES = 6
_LONGEST = 10  # words of a name
_LEAST_LETTERS = 4  # "ok" is Oklahoma only if it is tagged so
_SAME_WORD = pairs("same_word")


@dataclass(frozen=True)
class Link:
    """The values that a name may mean.

    Args:
        values: one value, or several that fit equally well; empty for an unknown name.
        score: the fit of the first value, from 0 to 1.
    """

    values: tuple[str, ...]
    score: float

    @property
    def is_exact(self) -> bool:
        """Whether it is one value, named in full."""
        return len(self.values) == 1 and self.score == 1.0


class Lexicon:
    """A domain's values by slot, with one canonical key for all spellings of a value.

    Args:
        domain: the domain; its phrases have other names for its values, and the kinds of slots.

    Attributes:
        domain: the domain.
        phrases: its phrases, see :func:`~bbq_torchrl.people.language.phrases.load_phrases`.
        kinds: the kind of quantity of each slot's values.
        keys: by slot, the canonical key of every name of its values.
        names: by slot, all names of its values and their plurals, split into words.

    Raises:
        PhrasesError: if the domain's phrases do not fit it.
    """

    def __init__(self, domain: Domain) -> None:
        self.domain, self.phrases = domain, load_phrases(domain)
        self._values = {
            slot: texts[FIRST_VALUE:]
            for slot, texts in zip(domain.slots, build_vocabulary(domain), strict=True)
            if slot not in domain.special_slots and len(texts) > FIRST_VALUE
        }
        self._frequency = Counter(
            (slot, fold(value))
            for record in (*domain.records, *(goal.constraints for goal in domain.goals))
            for slot, value in record.items()
        )
        self.kinds: dict[str, Kind] = {
            slot: self.phrases.slots[slot].kind or kind_of(values)
            for slot, values in self._values.items()
        }
        self._group = {
            slot: {
                compact(text): compact(value)
                for value, others in self.phrases.slots[slot].aliases.items()
                for text in (value, *others)
            }
            for slot in self._values
        }
        self.keys = {slot: self._keys(slot) for slot in self._values}
        self._spelled = {slot: self._spellings(slot) for slot in self._values}
        named = {slot: self._plurals(slot) | keys for slot, keys in self.keys.items()}
        self.names = {slot: {tuple(tokenize(text)) for text in own} for slot, own in named.items()}
        self._names = {
            slot: {compact(text): key for text, key in reversed(own.items())}
            for slot, own in named.items()
        }
        owners = Counter(name for names in self._names.values() for name in names)
        self._only = {
            name: slot for slot, names in self._names.items() for name in names if owners[name] == 1
        }
        self.link = lru_cache(maxsize=50_000)(self._link)
        self._near_names = cache(partial(_Names, self))

    @property
    def slots(self) -> tuple[str, ...]:
        """The slots that have values."""
        return tuple(self._values)

    def values(self, slot: str) -> tuple[str, ...]:
        """Returns the values of a slot, as the domain spells them."""
        return self._values[slot]

    def _keys(self, slot: str) -> dict[str, str]:
        """Returns the key of every name of a slot's values: their spellings, then other names."""
        keys = {value: self.key(slot, value) for value in self._values[slot]}
        known = set(keys.values())
        parts = Counter(part for value in keys for part in _parts_of(value))
        for value in [*keys] if self.kinds[slot] == "text" else ():
            own = (part for part in _parts_of(value) if parts[part] == 1)
            keys = dict.fromkeys(own, keys[value]) | keys
        for value, others in self.phrases.slots[slot].aliases.items():
            if (key := self.key(slot, value)) in known:
                keys |= dict.fromkeys(others, key)
        return keys

    def _plurals(self, slot: str) -> dict[str, str]:
        """Returns the key of the plural of every name of a slot's values."""
        keys = self.keys[slot] if self.kinds[slot] == "text" else {}
        return {plural: key for text, key in keys.items() if (plural := _plural(text))}

    def key(self, slot: str, value: str) -> str:
        """Returns the canonical key of a value, the same for all its spellings."""
        kind = self.kinds.get(slot, "text")
        if kind != "text" and (read := READERS[kind](value)) is not None:
            return read.rstrip("?")
        name = compact(value)
        return self._group.get(slot, {}).get(name, name)

    @cached_property
    def owners(self) -> dict[str, str]:
        """For each value (letters and digits) of several slots, the slot that has it most often."""
        holders: dict[str, Counter[str]] = defaultdict(Counter)
        for slot, values in self._values.items():
            for value in values:
                holders[compact(value)][slot] += self._frequency[slot, fold(value)]
        return {
            name: max(count, key=lambda slot: count[slot])
            for name, count in holders.items()
            if len(count) > 1
        }

    def _spellings(self, slot: str) -> dict[str, str]:
        """Returns the most frequent spelling of each key, the first of equal ones."""
        spelled: dict[str, str] = {}
        for value in sorted(self._values[slot], key=lambda v: -self._frequency[slot, fold(v)]):
            spelled.setdefault(self.keys[slot][value], value)
        return spelled

    def respell(self, slot: str, value: str) -> str:
        """Returns the most frequent spelling of a value; an unknown value is unchanged."""
        return self._spelled.get(slot, {}).get(self.key(slot, value), value)

    def _link(self, slot: str, text: str) -> Link:
        """Returns the value, or the values, that ``text`` names."""
        name, kind = compact(text), self.kinds[slot]
        if not name or (kind == "count" and _NEGATIVE.search(text)):
            return Link((), 0.0)
        if (key := self._names[slot].get(name)) is not None:
            return Link((self._spelled[slot][key],), 1.0)
        if kind != "text":
            if (read := READERS[kind](text)) is not None:
                return self._quantity(slot, read)
            if any(letter.isdigit() for letter in name):
                return Link((), 0.0)
        article, _, rest = fold(text).partition(" ")
        if article == "the" and compact(rest) in self._names[slot]:
            return self.link(slot, rest)  # "the matinee" must not match "the first matinee"
        return self._nearest(slot, text)

    def only_slot(self, text: str) -> str | None:
        """Returns the only slot that has a value of exactly this name, else ``None``.

        A quantity that nothing else can be, as "11 am", is of the only slot of its kind that an
        agent speaks of.
        """
        kind, spoken_of = sure_kind(text), {action.slot for action in self.domain.actions}
        slots = [slot for slot, own in self.kinds.items() if own == kind and slot in spoken_of]
        return self._only.get(compact(text), slots[0] if len(slots) == 1 else None)

    def place(self, words: Sequence[str], slot: str, value: str) -> range | None:
        """Returns the words that name a value best: its longest full name, else the best fit.

        Args:
            words: the words of a sentence, with ``""`` for those to leave out.
            slot: the slot.
            value: the value.
        """
        key = self.key(slot, value)

        def fit(at: range) -> float:
            link = self.link(slot, " ".join(words[at.start : at.stop]))
            return link.score if [self.key(slot, v) for v in link.values] == [key] else 0.0

        places, names = sorted(_places(words), key=len), self.names[slot]
        full = [at for at in places if tuple(words[at.start : at.stop]) in names and fit(at)]
        if full:
            return next(at for at in full if len(at) == len(full[-1]))
        best = max(places, key=fit, default=None)
        return best if best is not None and fit(best) else None

    def longer(self, words: Sequence[str], slot: str, name: str) -> tuple[str, ...]:
        """Returns the values of whose names a sentence has more words than a name."""
        said = {*words} - SMALL
        return tuple(v for v in self.values(slot) if {*name.split()} < said & {*tokenize(v)})

    def full_names(self, words: Sequence[str], asked: str | None = None) -> list[Span]:
        """Returns the longest full names of values that only one slot has, in no order.

        Args:
            words: the words of a sentence, with ``""`` for those to leave out.
            asked: the slot of names that several slots have.
        """
        found, left = [], list(words)
        for at in sorted(_places(words), key=len, reverse=True):
            name = " ".join(own := left[at.start : at.stop])
            slot = self.only_slot(name)
            if asked in self.slots and self.link(asked, name).is_exact:
                slot = asked
            if slot is None or not all(own) or name in POLITE:
                continue
            kind = self.kinds[slot]
            is_short = kind == "text" and len(name) < _LEAST_LETTERS and name.isalpha()
            is_number = kind == "count" and slot != asked and sure_kind(name) is None
            if not (is_short or is_number):
                found.append(Span(slot, at.start, at.stop))
                left[at.start : at.stop] = [""] * len(at)
        return found

    def _quantity(self, slot: str, read: str) -> Link:
        """Returns the value of a quantity's key, or else of one that is nearly the same."""
        known, key = self._spelled[slot], read.rstrip("?")
        head, _, part = key.rpartition(" ")
        keys = [key]
        if self.kinds[slot] == "time":
            if read.endswith("?"):
                hour, minute = part.split(":")
                keys.append(f"{head} {(int(hour) + 12) % 24:02}:{minute}")
            if head == "around":
                keys += [key.replace("around", "at") for key in keys]
        elif part in ("morning", "afternoon", "evening", "night", "noon") and head:
            other = {"evening": "night", "night": "evening"}.get(part, part)
            keys += [f"{head} {other}", head]
        elif head == "day":  # "the 12th" of the only month with one
            days = [key for key in known if key.endswith(f"/{part}")]
            keys += days if len(days) == 1 else []
        found = next((key for key in keys if key in known), None)
        return Link((), 0.0) if found is None else Link((known[found],), 1.0 - 0.1 * (found != key))

    def _nearest(self, slot: str, text: str) -> Link:
        """Returns the values whose names share the most informative words, allowing for typos."""
        scored = self._near_names(slot).scores(text)
        ranked = sorted(scored.items(), key=lambda item: -item[1])
        if not ranked or ranked[0][1] < _LEAST:
            return Link((), ranked[0][1] if ranked else 0.0)
        best = ranked[0][1]
        ties = [key for key, score in ranked[:_MAX_TIES] if score > best - _CLOSE]
        return Link(tuple(self._spelled[slot][key] for key in ties), best)


def _parts_of(title: str) -> list[str]:
    """Returns the parts of a title of more than two words: "the way of water"."""
    parts = re.split(r":\s+", title)
    return [part for part in parts if len(parts) > 1 and part.count(" ") > 1]


def _places(words: Sequence[str]) -> list[range]:
    """Returns the places of all names that words may contain."""
    is_word = [compact(word) != "" for word in words]
    return [
        range(start, end)
        for start in range(len(words))
        for end in range(start + 1, min(start + _LONGEST, len(words)) + 1)
        if is_word[start] and is_word[end - 1] and all(words[start:end])
    ]


class _Names:
    """The names of one slot's values, prepared for comparison with typed text."""

    def __init__(self, lexicon: Lexicon, slot: str) -> None:
        names = lexicon.keys[slot]
        self._keys = list(names.values())
        # No sets: sums and ties would depend on the hash order, which differs between processes.
        self._words = [dict.fromkeys(_important_words(name)) for name in names]
        count = Counter(word for words in self._words for word in words)
        total = 1 + len(self._words)
        self._weight = {
            word: _importance(word) * math.log(1 + total / n) for word, n in count.items()
        }
        self._like = lru_cache(maxsize=20_000)(self._likeness)
        self._unknown = 0.6 * math.log(1 + total)
        self._having: dict[str, list[int]] = defaultdict(list)
        for index, words in enumerate(self._words):
            for word in words:
                self._having[word].append(index)
        self._named = [sum(self._weight[word] for word in words) for words in self._words]

    def scores(self, text: str) -> dict[str, float]:
        """Returns the fit of each key, from 0 to 1, without poor fits."""
        scored: dict[str, float] = {}
        likenesses = [(word, self._like(word)) for word in dict.fromkeys(_important_words(text))]
        total = sum(
            max((self._weight[other] for other in like), default=0.0)
            or _importance(word) * self._unknown
            for word, like in likenesses
        )
        if not total:
            return scored
        # A name that shares only "the" is near to no other text than "the".
        main = [like for word, like in likenesses if word not in SMALL] or [
            like for _, like in likenesses
        ]
        near = {index for like in main for word in like for index in self._having[word]}
        for index in sorted(near):
            key, words, named = self._keys[index], self._words[index], self._named[index]
            shared = taken = 0.0
            for _, like in likenesses:
                if hits := [(share, other) for other, share in like.items() if other in words]:
                    share, other = max(hits)
                    shared += share * self._weight[other]
                    taken += self._weight[other]
            score = 0.88 * shared / total + 0.12 * taken / named if shared else 0.0
            if score > scored.get(key, 0.3):
                scored[key] = min(score, 1.0) * 0.98
        return scored

    def _likeness(self, word: str) -> dict[str, float]:
        """Returns the words of names that ``word`` may stand for, and how similar they are."""
        if word in self._weight:
            return {word: 1.0}
        if len(word) <= 3 or word.isdecimal():
            return {}
        process, osa = fuzzy()
        similar, names = osa.normalized_similarity, list(self._weight)
        near = process.extract(word, names, scorer=similar, score_cutoff=0.72, limit=3)
        return {other: score for other, score, _ in near if len(other) > 2}


def _plural(name: str) -> str:
    """Returns the plural of a name; empty for a short one, and one that may be a plural."""
    word = name.split()[-1]
    if len(word) < 4 or not word[-3:].isalpha() or word.endswith("s"):
        return ""
    return f"{name[:-1]}ies" if word[-1] == "y" and word[-2] not in "aeiou" else f"{name}s"


def _importance(word: str) -> float:
    return 0.15 if word in SMALL else 1.0


def _important_words(text: str) -> list[str]:
    """Returns the words of a name, numbers as digits: ``"creed iii"`` and ``"Creed 3"`` agree."""
    words = tokenize(text.replace("-", "") if not any(c.isdigit() for c in text) else text)
    return [_SAME_WORD.get(word, word) for word in words if any(c.isalnum() for c in word)]


def fuzzy() -> tuple[Any, Any]:
    """Returns rapidfuzz's searches, and its edit distance with swapped letters."""
    distance = needed("rapidfuzz", "rapidfuzz.distance")
    return needed("rapidfuzz", "rapidfuzz.process"), distance.OSA
