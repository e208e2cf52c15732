"""Training sentences: labeled lines, and out-of-domain sentences.

A labeled line is ``agent's last act | sentence | meaning``.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from bbq_torchrl.domains import Domain
from bbq_torchrl.domains.frames import ANY, Frame
from bbq_torchrl.people.language.asking import FOREIGN, OPENING, YES
from bbq_torchrl.people.language.corpus import Example, spoiled, tag
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.paraphrase import Paraphraser
from bbq_torchrl.people.language.phrases import Piece, choose, parse
from bbq_torchrl.people.language.words import (
    ENGLISH,
    OUTSIDE,
    SMALL,
    spans_of,
    tokenize,
    untagged,
    words_of,
)
from bbq_torchrl.utils.text import FaultsError

_TRIES = 10
_LONGEST_WORD = 9  # letters of a made-up word
_LIKE = 0.75  # a name that fits a value this well is a misspelling of it
_FOREIGN = [parse(text) for text in ENGLISH["foreign"]]


def make_foreign(
    lexicon: Lexicon, others: Sequence[Example], count: int, seed: int
) -> list[Example]:
    """Returns out-of-domain sentences.

    Args:
        lexicon: the domain's phrases and values.
        others: sentences whose questions half of the result answers.
        count: the number of sentences.
        seed: the seed of all random choices.
    """
    rng = random.Random(seed)
    paraphrase = Paraphraser(lexicon)
    templates = [*_FOREIGN, *lexicon.phrases.user["foreign"]]
    found = []
    for _ in range(count):
        values = {
            slot: [Piece(paraphrase(slot, rng.choice(lexicon.values(slot)), rng), slot)]
            for slot in lexicon.slots
        }
        question = OPENING if rng.random() < 0.5 else rng.choice(others).question
        words, tags = tag(choose(templates, values, lexicon.phrases.rules, rng))
        found.append(Example(words, tags, FOREIGN, question))
    return [example for example in spoiled(found, seed) if example.words]


class Names:
    """Makes up names shaped like a value, from words of values, ordinary and invented words.

    Args:
        lexicon: the values and their names.
    """

    def __init__(self, lexicon: Lexicon) -> None:
        self._lexicon = lexicon
        self._values = {
            slot: [tokenize(value) for value in lexicon.values(slot)]
            for slot in lexicon.slots
            if lexicon.kinds[slot] == "text"
        }
        own = [word for values in self._values.values() for value in values for word in value]
        self._own = [word for word in own if word not in SMALL]
        self._next: dict[str, list[str]] = {}
        for word in filter(str.isalpha, self._own):
            for at in range(len(word) + 1):
                key = f"^^{word}"[at : at + 2]
                self._next.setdefault(key, []).append(f"{word}$"[at])
        texts = [text for text in ENGLISH["foreign"] if text.isascii()]
        self._ordinary = [word for text in texts for word in tokenize(text) if len(word) > 3]

    def made_up(self, slot: str, rng: random.Random) -> list[str]:
        """Returns the words of a name that no value has; empty if that fails, or for numbers."""
        if slot not in self._values:
            return []
        for _ in range(_TRIES):
            shape = rng.choice(self._values[slot])
            words = [word if word in SMALL else self._word(rng) for word in shape]
            name = " ".join(words)
            link = self._lexicon.link(slot, name)
            if words != shape and link.score < _LIKE and self._lexicon.only_slot(name) is None:
                return words
        return []

    def _word(self, rng: random.Random) -> str:
        kind = rng.random()
        if kind < 0.25 or not self._next:
            return rng.choice(self._own)
        if kind < 0.5:
            return rng.choice(self._ordinary)
        word = ""
        while len(word) < _LONGEST_WORD:
            letter = rng.choice(self._next.get(f"^^{word}"[-2:], ["$"]))
            if letter == "$":
                break
            word += letter
        return word


LEARNED_FILE = "learned.txt"
"""Labeled lines in a domain's folder, as people type them, learned along with the grammar's."""

DRILLED_FILE = "drilled.txt"
"""Labeled lines written for hard cases: learned, but not used for the confidence."""

_UNKNOWN = "?"
"""The prefix of a name that the domain does not have: ``city=?toledo``."""

_MADE_UP = 0.4


class Line(NamedTuple):
    """A labeled sentence.

    Attributes:
        question: the agent's last act; ``None`` at the opening.
        text: the user's sentence.
        frame: its meaning.
    """

    question: Frame | None
    text: str
    frame: Frame


def read_lines(path: str | Path, domain: Domain) -> list[Line]:
    """Returns the labeled lines of a file, without empty lines and those that begin with ``#``.

    Args:
        path: a UTF-8 text file.
        domain: the domain whose acts and slots the labels may name.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if a line is written in another way: every fault with its line.
    """
    lines, faults = [], []
    try:
        content = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FaultsError(str(path), [f"it must be UTF-8 text: {error}"]) from None
    for number, line in enumerate(content.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        parts = [part.strip() for part in line.split("|")]
        if len(parts) != 3:
            faults.append(
                f"line {number} must be written 'agent act | sentence | meaning', got {line!r}"
            )
            continue
        try:
            words_of(parts[1])
            question = Frame.parse(parts[0], domain) if parts[0] else None
            lines.append(Line(question, parts[1], Frame.parse(parts[2], domain)))
        except ValueError as error:
            faults.append(f"line {number}: {error}")
    if faults:
        raise FaultsError(str(path), faults)
    return lines


def lines_of(domain: Domain, name: str) -> list[Line]:
    """Returns the labeled lines of a file in a domain's folder; empty without such a file."""
    path = None if domain.folder is None else domain.folder / name
    return read_lines(path, domain) if path is not None and path.is_file() else []


def without_unknown(frame: Frame) -> Frame:
    """Returns a labeled frame without unknown names, which the nlu reports separately."""
    informs = {slot: v for slot, v in frame.informs.items() if not v.startswith(_UNKNOWN)}
    return replace(frame, informs=informs)


def as_examples(lines: Sequence[Line], lexicon: Lexicon) -> list[Example]:
    """Returns labeled lines as training sentences.

    Each value is located at the words that are read as it. A line in which a value is not found
    still teaches acts and questions with its other words.
    """
    examples = []
    for question, text, frame in lines:
        words = words_of(text)
        tags = [OUTSIDE] * len(words)
        for slot, value in frame.informs.items():
            if value == ANY or slot not in lexicon.names:
                continue  # of a slot without values, such as "anything of that series"
            if value.startswith(_UNKNOWN):
                place = _said(words, tokenize(value.removeprefix(_UNKNOWN)))
            else:
                place = lexicon.place(untagged(words, tags), slot, value)
            if place is not None:
                tags[place.start : place.stop] = [slot] * len(place)
        heard, takes = without_unknown(frame), frame.act in YES
        if takes and heard.informs:  # "yes, two seats"
            heard = replace(heard, act="request" if heard.requests else "inform")
        examples.append(Example(words, tags, heard, question or OPENING, takes))
    return examples


def _said(words: list[str], name: list[str]) -> range | None:
    """Returns the position of a name in the words."""
    starts = range(len(words) - len(name) + 1)
    found = (at for at in starts if words[at : at + len(name)] == name)
    return next((range(at, at + len(name)) for at in found), None)


def varied(
    examples: Sequence[Example], lexicon: Lexicon, paraphrase: Paraphraser, copies: int, seed: int
) -> list[Example]:
    """Returns copies of sentences with other values.

    Some names in the copies are made up, so that the context is what reveals an unknown name.

    Args:
        examples: the sentences.
        lexicon: the values.
        paraphrase: the ways to write values.
        copies: the number of copies of each sentence.
        seed: the seed of the values.
    """
    rng = random.Random(seed)
    names = Names(lexicon)
    found = []
    for example in examples:
        for _ in range(copies):
            words, tags, at = [], [], 0
            for slot, start, end in spans_of(example.tags):
                value = rng.choice(lexicon.values(slot))
                other = names.made_up(slot, rng) if rng.random() < _MADE_UP else []
                other = other or tokenize(paraphrase(slot, value, rng))
                words += [*example.words[at:start], *other]
                tags += [*example.tags[at:start], *[slot] * len(other)]
                at = end
            words, tags = words + example.words[at:], tags + example.tags[at:]
            found.append(replace(example, words=words, tags=tags))
    return found
