"""The tagger of slots: a linear-chain conditional random field (python-crfsuite)."""

from __future__ import annotations

import tempfile
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.utils.extras import needed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

OUTSIDE = "-"
"""The tag of a word that is part of no value."""

_SURE = 0.6


class Span(NamedTuple):
    """Words that name a value.

    Attributes:
        slot: of which slot.
        start: the first word.
        end: the word after the last.
    """

    slot: str
    start: int
    end: int


class Tagger:
    """Tags words by their features.

    Args:
        model: the field as crfsuite writes it.
    """

    def __init__(self, model: bytes) -> None:
        self.model = model
        self._tagger = needed("python-crfsuite", "pycrfsuite").Tagger()
        self._tagger.open_inmemory(model)

    @classmethod
    def train(
        cls,
        rows: Sequence[Sequence[Sequence[str]]],
        tags: Sequence[Sequence[str]],
        steps: int,
        tick: Callable[[], object] = bool,
    ) -> Tagger:
        """Returns a tagger fitted to sentences.

        Args:
            rows: the features of each word of each sentence.
            tags: the tags of the same.
            steps: of L-BFGS, at most.
            tick: called after each.
        """
        trainer = needed("python-crfsuite", "pycrfsuite").Trainer()
        trainer.message = lambda text: tick() if "Iteration #" in text else None
        for row, own in zip(rows, tags, strict=True):
            trainer.append(row, own)
        trainer.set_params({"c1": 0.05, "c2": 0.02, "max_iterations": steps, "feature.minfreq": 2})
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "tagger.crf"
            trainer.train(str(path))
            return cls(path.read_bytes())

    def __call__(
        self, rows: Sequence[Sequence[str]], is_unknown: Sequence[bool]
    ) -> tuple[list[str], float, list[float]]:
        """Returns the best tags of a sentence, their probability, and that of each tag.

        Args:
            rows: the features of each word, of one word or more.
            is_unknown: of each word, whether it is unknown: it is part of a name unless that is
                unlikely.
        """
        tags = self._tagger.tag(rows)
        for at in (at for at, tag in enumerate(tags) if tag == OUTSIDE and is_unknown[at]):
            if self._tagger.marginal(OUTSIDE, at) < _SURE:
                slots = (slot for slot in self._tagger.labels() if slot != OUTSIDE)
                tags[at] = max(slots, key=lambda slot: self._tagger.marginal(slot, at))
        each = [self._tagger.marginal(tag, at) for at, tag in enumerate(tags)]
        return tags, self._tagger.probability(tags), each


def spans_of(tags: Sequence[str]) -> list[Span]:
    """Returns the spans that tags mark.

    Examples:
        >>> spans_of([OUTSIDE, "city", "city", "date"])
        [Span(slot='city', start=1, end=3), Span(slot='date', start=3, end=4)]
    """
    spans = []
    for slot, tagged in groupby(enumerate(tags), key=lambda item: item[1]):
        places = [at for at, _ in tagged]
        if slot != OUTSIDE:
            spans.append(Span(slot, places[0], places[-1] + 1))
    return spans
