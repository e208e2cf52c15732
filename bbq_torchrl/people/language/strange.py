"""Limits of a domain: sentences that it cannot mean, and names of no value."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from bbq_torchrl.people.language.asking import FOREIGN, OPENING
from bbq_torchrl.people.language.corpus import Example, spoiled, tag
from bbq_torchrl.people.language.surfaces import Surfaces
from bbq_torchrl.people.language.templates import Piece, choose, parse
from bbq_torchrl.people.language.words import ENGLISH, tokenize, word_set

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.people.language.lexicon import Lexicon

_TRIES = 10
_LONGEST = 9  # letters of a made-up word
_LIKE = 0.75  # a name that fits a value as well is a slip of it
_SMALL = word_set("small")
_FOREIGN = [parse(text) for text in ENGLISH["foreign"]]


def make_foreign(
    lexicon: Lexicon, others: Sequence[Example], count: int, seed: int, part: slice = slice(None)
) -> list[Example]:
    """Returns sentences that the domain cannot mean.

    Args:
        lexicon: the domain's phrases and values.
        others: sentences, of whose questions half of these are answers.
        count: how many.
        seed: chooses all.
        part: of the phrases, those to use.
    """
    rng = random.Random(seed)
    surfaces = Surfaces(lexicon)
    templates = [*_FOREIGN, *lexicon.phrases.user["foreign"]][part]
    found = []
    for _ in range(count):
        values = {
            slot: [Piece(surfaces(slot, rng.choice(lexicon.values(slot)), rng), slot)]
            for slot in lexicon.slots
        }
        question = OPENING if rng.random() < 0.5 else rng.choice(others).question
        words, tags = tag(choose(templates, values, lexicon.phrases.rules, rng))
        found.append(Example(words, tags, FOREIGN, question))
    return [example for example in spoiled(found, seed) if example.words]


class Names:
    """Makes up names: in the shape of a value, of its other words, ordinary and invented ones.

    Args:
        lexicon: the values, and what names they have.
    """

    def __init__(self, lexicon: Lexicon) -> None:
        self._lexicon = lexicon
        self._values = {
            slot: [tokenize(value) for value in lexicon.values(slot)]
            for slot in lexicon.slots
            if lexicon.kinds[slot] == "text"
        }
        own = [word for values in self._values.values() for value in values for word in value]
        self._own = [word for word in own if word not in _SMALL]
        self._next: dict[str, list[str]] = {}
        for word in filter(str.isalpha, self._own):
            for at in range(len(word) + 1):
                key = f"^^{word}"[at : at + 2]
                self._next.setdefault(key, []).append(f"{word}$"[at])
        texts = [text for text in ENGLISH["foreign"] if text.isascii()]
        self._ordinary = [word for text in texts for word in tokenize(text) if len(word) > 3]

    def made_up(self, slot: str, rng: random.Random) -> list[str]:
        """Returns the words of a name that no value has; none where that fails, or of numbers."""
        if slot not in self._values:
            return []
        for _ in range(_TRIES):
            shape = rng.choice(self._values[slot])
            words = [word if word in _SMALL else self._word(rng) for word in shape]
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
        while len(word) < _LONGEST:
            letter = rng.choice(self._next.get(f"^^{word}"[-2:], ["$"]))
            if letter == "$":
                break
            word += letter
        return word
