"""What becomes of sentences when people type them: typos, slang, filler, missing words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.people.language.tagger import OUTSIDE
from bbq_torchrl.people.language.words import pairs, word_set

if TYPE_CHECKING:
    import random
    from collections.abc import Sequence

Tagged = list[tuple[str, str]]
"""Words, each with its tag."""

_KEYS = pairs("keys")
_SLANG = pairs("slang")
DROPPED = word_set("dropped")
_SWAPPED = {word: others.split(",") for word, others in pairs("swapped").items()}


def typo(word: str, rng: random.Random) -> str:
    """Returns the word with one slip of the fingers; very short words as they are."""
    if len(word) < 3 or not word.isalpha():
        return word
    at = rng.randrange(1, len(word))
    kind = rng.randrange(4)
    if kind == 0:
        return word[:at] + word[at + 1 :]
    if kind == 1:
        return word[: at - 1] + word[at] + word[at - 1] + word[at + 1 :]
    if kind == 2:
        return word[:at] + word[at] + word[at:]
    return word[:at] + rng.choice(_KEYS.get(word[at].lower(), word[at])) + word[at + 1 :]


def with_typos(words: Sequence[str], share: float, rng: random.Random) -> list[str]:
    """Returns the words, each with a slip by the chance ``share``."""
    return [typo(word, rng) if rng.random() < share else word for word in words]


def lowered(text: str) -> str:
    """Returns a text in lower case without marks, but those inside of numbers and words."""
    kept = [
        letter
        for at, letter in enumerate(text)
        if letter.isalnum()
        or letter.isspace()
        or letter in "$%&@'"
        or (0 < at < len(text) - 1 and text[at - 1].isalnum() and text[at + 1].isalnum())
    ]
    return " ".join("".join(kept).lower().split())


def slangy(tagged: Tagged, rng: random.Random) -> Tagged:
    """Returns a sentence in which some words are written as in short messages."""
    share = rng.choice((0.2, 0.5))
    return [
        (_SLANG.get(word, word) if tag == OUTSIDE and rng.random() < share else word, tag)
        for word, tag in tagged
    ]


def as_second_language(tagged: Tagged, rng: random.Random) -> Tagged:
    """Returns a sentence that lost small words, with others in their place."""
    kept = []
    for word, tag in tagged:
        if tag == OUTSIDE and word in DROPPED and rng.random() < 0.3:
            continue
        if tag == OUTSIDE and word in _SWAPPED and rng.random() < 0.2:
            word = rng.choice(_SWAPPED[word])
        if tag == OUTSIDE and rng.random() < 0.02:
            kept.append(("the", OUTSIDE))
        kept.append((word, tag))
    return kept or tagged
