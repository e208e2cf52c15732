"""Features of a sentence for the tagger and the net."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from functools import lru_cache

from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.language.lexicon import Lexicon, fuzzy
from bbq_torchrl.people.language.quantities import (
    COUNT_WORDS,
    DAY_WORDS,
    MONTH_WORDS,
    NUMBER_WORDS,
    ORDINAL_WORDS,
    PART_WORDS,
    READERS,
    RELATION_WORDS,
    Kind,
)
from bbq_torchrl.people.language.words import OUTSIDE, compact, spans_of, word_set

_LONGEST = 9
_LONGEST_QUANTITY = 6
QUANTITIES = ("time", "date", "count")
UNKNOWN = "<unknown>"


class Features:
    """Names of features, as text, of words and of whole sentences.

    Args:
        lexicon: the names to look for, the longest at each position, and the nouns of the slots.
        known: the words of the training sentences; others are corrected to one of them by one
            letter, or are unknown.
    """

    def __init__(self, lexicon: Lexicon, known: Iterable[str]) -> None:
        self._offer = lexicon.domain.complete_slot
        self._names: dict[str, dict[str, set[str]]] = {}
        self._part: dict[str, set[str]] = defaultdict(set)
        for slot, names in lexicon.names.items():
            self._names[slot] = defaultdict(set)
            for name in filter(None, names):
                self._names[slot][name[0]].add(" ".join(name))
                for word in name if lexicon.kinds[slot] == "text" else ():
                    if len(word) > 2:
                        self._part[word].add(slot)
        self._nouns: dict[str, list[str]] = defaultdict(list)
        for slot, entry in lexicon.phrases.slots.items():
            for noun in entry.nouns:
                self._nouns[noun].append(slot)
        self.known = frozenset(word.replace("'", "") for word in known)
        self._all = {*self.known, *self._part}
        self._long = sorted(word for word in self._all if word.isalpha() and len(word) > 3)
        self.spelled = lru_cache(maxsize=20_000)(self._spelled)

    def _spelled(self, word: str) -> str:
        """Returns the word, a known word at edit distance 1, or :data:`UNKNOWN`."""
        word = word.replace("'", "") or word
        if word in self._all or not word.isalpha():
            return word
        if len(word) < 4:
            return UNKNOWN
        process, osa = fuzzy()
        near = process.extractOne(word, self._long, scorer=osa.distance, score_cutoff=1)
        return UNKNOWN if near is None else str(near[0])

    def of_words(self, words: Sequence[str], question: Frame) -> list[list[str]]:
        """Returns the features of each word."""
        spelled = [self.spelled(word) for word in words]
        classes = [_class(word) for word in spelled]
        found = self._windows(spelled)
        self._quantities(words, found)
        asked = _question(question)
        own = []
        for at, (word, kind) in enumerate(zip(spelled, classes, strict=True)):
            raw = words[at]
            row = [f"w={word}", f"c={kind}", f"s={raw[-3:]}", f"p={raw[:3]}", *found[at]]
            row += [f"in:{slot}" for slot in sorted(self._part.get(word, ()))]
            row += [f"noun:{slot}" for slot in self._nouns.get(word, ())]
            own.append(row)
        rows = []
        for at in range(len(words)):
            row = ["bias", *own[at]]
            for step in (-2, -1, 1, 2):
                near = at + step
                if not 0 <= near < len(words):
                    row.append(f"{step}:edge")
                    continue
                row += [f"{step}:w={spelled[near]}", f"{step}:c={classes[near]}"]
                if abs(step) == 1:
                    row += [f"{step}:{name}" for name in found[near]]
                    pair = "_".join(spelled[min(at, near) : max(at, near) + 1])
                    row += [f"{step}:2={pair}", f"{step}:cc={classes[near]}_{classes[at]}"]
            row += [f"q={item}" for item in asked]
            if any(f"ask:{name.split(':')[1]}" in asked for name in found[at]):
                row += ["asked", f"asked&n={min(len(words), 4)}"]
            if len(words) < 3:
                row += [f"short&{item}" for item in asked]
            seen = (f"c={classes[at]}", *found[at])
            row += [f"q={item}&{name}" for item in asked for name in seen]
            rows.append(row)
        return rows

    def _quantities(self, words: Sequence[str], found: list[list[str]]) -> None:
        """Adds to ``found``, for each word, the kinds of quantity it begins or continues."""
        for kind in QUANTITIES:
            end = 0
            for start, word in enumerate(words):
                can_start = word in _STARTS or word[0].isdigit() or word[1:].isdecimal()
                if start < end or not can_start:
                    continue
                for stop in range(min(start + _LONGEST_QUANTITY, len(words)), start, -1):
                    # "night at 7" began one word earlier: "friday night at 7".
                    is_part = kind == "time" and stop > start + 1 and word in PART_WORDS
                    if is_part or words[stop - 1] in _ENDS:
                        continue
                    if _is_read(kind, " ".join(words[start:stop])):
                        end = stop
                        for at in range(start, stop):
                            found[at].append(f"{kind}:{'I' if at > start else 'B'}")
                        break

    def _windows(self, words: Sequence[str]) -> list[list[str]]:
        """Returns, for each word, the slots of which it begins or continues a name."""
        found: list[list[str]] = [[] for _ in words]
        for slot, by_first in self._names.items():
            if by_first.keys().isdisjoint(words):
                continue
            at = 0
            while at < len(words):
                names = by_first.get(words[at], ())
                sizes = range(min(_LONGEST, len(words) - at), 0, -1) if names else ()
                fits = (size for size in sizes if " ".join(words[at : at + size]) in names)
                length = next(fits, 0)
                for index in range(length):
                    extent = str(length) if length < 3 else "n"
                    found[at + index].append(f"g:{slot}:{'I' if index else 'B'}{extent}")
                at += max(length, 1)
        return found

    def of_sentence(self, words: Sequence[str], tags: Sequence[str], question: Frame) -> list[str]:
        """Returns the features of the whole sentence, with values replaced by their slots."""
        line: list[str] = []
        asked = _question(question)
        told = question.informs
        act = "offer" if self._offer in told else question.act
        slots = []
        spans = {span.start: span.slot for span in spans_of(tags)}
        for at, (word, tag) in enumerate(zip(words, tags, strict=True)):
            if tag == OUTSIDE:
                line.append(self.spelled(word))
            elif at in spans:
                line.append(f"<{tag}>")
                slots.append(tag)
        items = ["bias", *(f"q={item}" for item in asked)]
        items += [f"n={min(len(line), 8)}", f"k={min(len(slots), 4)}"]
        nouns = self._nouns
        abstract = [f"N:{nouns[word][0]}" if word in nouns else word for word in line]
        line, abstract = ["^", *line, "$"], ["^", *abstract, "$"]
        named = [slot for word in line for slot in nouns.get(word, ())]
        content = [word for word in line if word.isalnum() or word[0] in "<^$" or "'" in word]
        for size in (1, 2, 3):
            items += [f"{size}={run}" for run in _runs(content, size)]
        for size in (2, 3):
            items += [f"a{size}={run}" for run in _runs(abstract, size)]
        items += [f"skip={a}_{b}" for a, b in zip(content, content[2:], strict=False)]
        items += [f"stem={word[:4]}" for word in content if len(word) > 4 and word[0].isalpha()]
        items += [f"N={slot}" for slot in named]
        items += [f"S={slot}" for slot in slots]
        items += [f"q={act}&1={word}" for word in content]
        items += [f"q={act}&2={run}" for run in _runs(content, 2)]
        items += [f"q&S={slot in asked}{slot in told}" for slot in slots]
        items += [f"q&N={slot in asked}{slot in told}" for slot in named]
        items += [f"first={content[1]}", f"first={'_'.join(content[1:3])}", f"last={content[-2]}"]
        items += [f"q={act}&first={content[1]}"]
        if "?" in words:
            items.append("question-mark")
        return items


def _runs(words: Sequence[str], size: int) -> list[str]:
    """Returns the n-grams of ``size`` words, joined."""
    return ["_".join(words[at : at + size]) for at in range(len(words) - size + 1)]


@lru_cache(maxsize=100_000)
def _is_read(kind: Kind, text: str) -> bool:
    if kind == "count" and not all(w in COUNT_WORDS or w[0].isdigit() for w in text.split()):
        return False  # The reader accepts any words with one number.
    return READERS[kind](text) is not None


def _question(question: Frame) -> list[str]:
    told = [f"inform:{slot}" for slot in question.informs]
    return [question.act, *(f"ask:{slot}" for slot in question.requests), *told[:1]]


def _class(word: str) -> str:
    """Returns the class of a word: a number, a day, a clock, ..."""
    if word == UNKNOWN:
        return "unknown"
    if word.isdecimal():
        return f"d{len(word)}" if len(word) < 6 else "d+"
    if word[0].isdigit():
        is_clock = not {*word}.isdisjoint(":.h")
        return "clock" if is_clock else "date" if "/" in word else "mixed"
    other = "word" if compact(word) else "mark"
    return next((name for name, words in _CLASSES if word in words), other)


_CLASSES = (
    ("number", NUMBER_WORDS),
    ("ordinal", ORDINAL_WORDS),
    ("day", DAY_WORDS),
    ("month", MONTH_WORDS),
    ("part", PART_WORDS),
    ("relation", RELATION_WORDS),
    ("meridian", frozenset(("am", "pm", "a.m", "p.m", "a.m.", "p.m."))),
    ("suffix", frozenset(("st", "nd", "rd", "th"))),
)
_STARTS = word_set("quantities_begin").union(*(words for _, words in _CLASSES[:6]))
_ENDS = word_set("quantities_never_end")
