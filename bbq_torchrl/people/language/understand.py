"""From what a user types to a frame with values of the domain."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from bbq_torchrl.people.language.asking import FOREIGN, OPENING, Understood
from bbq_torchrl.people.language.assemble import assemble
from bbq_torchrl.people.language.confidence import CUES, cues_of, fit_confidence, probability
from bbq_torchrl.people.language.corpus import make_examples, spoiled
from bbq_torchrl.people.language.features import Features
from bbq_torchrl.people.language.labeled import (
    DRILLED_FILE,
    LEARNED_FILE,
    as_examples,
    lines_of,
    make_foreign,
    varied,
)
from bbq_torchrl.people.language.learners import EPOCHS, OUTSIDE, IntentNet, Tagger
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.model import Model, fit
from bbq_torchrl.people.language.model_file import read_model, write_model
from bbq_torchrl.people.language.surfaces import DROPPED, Surfaces
from bbq_torchrl.people.language.words import capitalized, words_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.domains.frames import Frame
    from bbq_torchrl.people.language.asking import Unclear
    from bbq_torchrl.people.language.corpus import Example
    from bbq_torchrl.people.language.labeled import Line

SENTENCES = 7_200
"""The most sentences of people to learn from."""

THRESHOLD = 0.75
"""The confidence below which to ask again: .8 of the sentences of unseen hands are above it."""

_STEPS, _BLIND_STEPS = 40, 30  # of the tagger's optimizer

TICKS = _STEPS + _BLIND_STEPS + 2 * EPOCHS
"""The most steps of learning."""

_MAX_WORDS = 120
_CALM = 0.3  # sentences of the grammar are more crowded than those of people
_OWN = 4  # at least one sentence of the grammar for this many others
_PLAYED = 4  # sentences of simulated users to one of the others
_TAGGED = 16  # the tagger learns from one in so many of these
_COPIES = 4  # at most, of each of people's sentences, with other values
_UNKNOWN = 4  # one in so many of the grammar's sentences is learned with other values, too
_FOREIGN = 4  # to one sentence that the domain cannot mean, so many of people's
_SHARE = 4  # the smaller model learns from one in so many of the grammar's sentences


class Understander:
    """Understands users of a domain.

    Args:
        lexicon: the phrases and values of what is spoken of.
        model: the learned parts.
        calibration: weights ``[CUES]`` from cues to the log-odds that a frame is right.
        threshold: the confidence below which the caller should ask again.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> understand = Understander.train(movie_domain())  # doctest: +SKIP
        >>> str(understand("two tickets for wonka please").frame)  # doctest: +SKIP
        'request(ticket) inform(numberofpeople=2, moviename=wonka)'
    """

    def __init__(
        self,
        lexicon: Lexicon,
        model: Model,
        calibration: Sequence[float] | np.ndarray,
        threshold: float = THRESHOLD,
    ) -> None:
        self.domain, self.lexicon = lexicon.domain, lexicon
        self.threshold = threshold
        self._model = model
        self._calibration = np.array(calibration, dtype=np.float64)

    @classmethod
    def train(
        cls,
        domain: Domain,
        *,
        sentences: int = SENTENCES,
        seed: int = 0,
        labeled: Sequence[Line] = (),
        threshold: float = THRESHOLD,
        tick: Callable[[], object] = bool,
    ) -> Understander:
        """Returns an understander that has learned from sentences of the domain's own grammar.

        Equal arguments give equal bits. Torch runs on one thread meanwhile.

        Args:
            domain: what is spoken of. Its folder may have its ``language.yaml``, and labeled lines
                of people, which are learned with the own sentences: ``learned.txt``, as people
                type, and ``drilled.txt``, written for what is hard. The confidence is fitted to a
                quarter of the former, as a smaller model understands them that has learned from
                half of it.
            sentences: how many of people's to learn from, at most. The grammar's own fill them up
                and are a quarter as many at least; those of simulated users are four times as many,
                and most of them for the net alone.
            seed: chooses them, and the net's first weights.
            labeled: lines of people's, learned as ``learned.txt``.
            threshold: the confidence below which the caller should ask again.
            tick: called as it goes forward, at most :data:`TICKS` times.

        Raises:
            ValueError: if there are no sentences to learn from.
        """
        if sentences < 1:
            raise ValueError(f"sentences must be at least 1, got {sentences}")
        lexicon = Lexicon(domain)
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            lines, drilled = lines_of(domain, LEARNED_FILE), lines_of(domain, DRILLED_FILE)
            step = math.ceil((len(lines) + len(drilled)) / sentences) or 1
            people = as_examples([*lines[::step], *labeled], lexicon)
            hard = as_examples(drilled[::step], lexicon)
            own = max(sentences - len(people) - len(hard), -(-sentences // _OWN))
            said = make_examples(lexicon, own, seed)
            played = make_examples(lexicon, _PLAYED * sentences, seed, simulated=True)
            surfaces = Surfaces(lexicon)
            copies = min(_COPIES, round(sentences / max(len(people) + len(hard), 1)))

            def learned(
                examples: Sequence[Example], share: int, steps: int, part: slice = slice(None)
            ) -> Model:
                """Returns a model of people's sentences and of one in ``share`` of the others."""
                own = said[::share]
                lines = varied([*examples, *hard], lexicon, surfaces, copies, seed)
                some = own[::_UNKNOWN]
                lines += varied(some, lexicon, surfaces, 1, seed)[len(some) :]
                foreign = make_foreign(lexicon, said, sentences // _FOREIGN, seed, part)
                given = [*own, *spoiled(lines, seed), *played[:: _TAGGED * share]]
                net = played[:: share * share]
                return fit(lexicon, given, net, foreign, seed=seed, steps=steps, tick=tick)

            model = learned(people, 1, steps=_STEPS)
            others = make_examples(lexicon, max(sentences // 20, 200), seed + 1, noise=_CALM)
            start = np.zeros(CUES)
            foreign = make_foreign(lexicon, said, len(others) // 2, seed + 1)
            judged, apart = cls(lexicon, model, start)._judged([*others, *foreign]), None
            if people[1::2]:
                # How sure to be is learned of people's sentences that the model has not seen.
                seen, unseen = slice(0, None, 2), slice(1, None, 2)
                blind = cls(lexicon, learned(people[seen], _SHARE, _BLIND_STEPS, seen), start)
                unknown = make_foreign(lexicon, said, len(people) // 20, seed + 1, unseen)
                apart = blind._judged([*people[1::4], *unknown])
            calibration = fit_confidence(judged, apart)
        finally:
            torch.set_num_threads(threads)
        return cls(lexicon, model, calibration, threshold)

    def __call__(self, text: str, question: Frame | None = None) -> Understood:
        """Returns the meaning of ``text``.

        Args:
            text: what the user typed.
            question: the agent's last act; ``None`` at the opening.

        Raises:
            TextError: a ``ValueError`` fit to be shown, if nothing of the text can be read or it
                is too long.
        """
        words = words_of(text)[:_MAX_WORDS]
        frame, unclear, cues = self._hear(words, question or OPENING, capitalized(text))
        return Understood(frame, probability(cues, self._calibration), unclear)

    def asks(self, understood: Understood) -> bool:
        """Returns whether the system should ask again rather than act on it."""
        return understood.confidence < self.threshold or bool(understood.unclear)

    def _hear(
        self, words: Sequence[str], question: Frame, capitals: frozenset[str]
    ) -> tuple[Frame, tuple[Unclear, ...], np.ndarray]:
        """Returns the frame of some words, what is unclear, and the cues of how sure that is."""
        reading = self._model.read(words, question, capitals)
        frame, unclear = assemble(words, reading, question, self.lexicon)
        chance = reading.acts[self.domain.acts.index(frame.act)].exp().item()
        tagged = zip(words, reading.tags, strict=True)
        shorter = [word for word, tag in tagged if tag != OUTSIDE or word not in DROPPED]
        is_steady = True
        if shorter and len(shorter) < len(words):
            again = self._model.read(shorter, question, capitals)
            other, _ = assemble(shorter, again, question, self.lexicon)
            is_steady = same_frame(frame, other, self.lexicon)
        cues = cues_of(words, reading, frame, unclear, chance=chance, is_steady=is_steady)
        return frame, unclear, cues

    def _judged(self, sentences: Sequence[Example]) -> tuple[np.ndarray, np.ndarray]:
        """Returns the cues ``[N, CUES]`` of sentences, and which frames are right ``[N]``."""
        rows, right = [], []
        for example in sentences:
            frame, _, cues = self._hear(example.words, example.question, example.capitals)
            rows.append(cues)
            right.append(same_frame(frame, example.frame, self.lexicon))
        return np.array(rows), np.array(right)

    def save(self, path: str | Path) -> None:
        """Writes the learned parts into one file, in numpy's format without pickles."""
        model = self._model
        about = {
            "domain": self.domain.name,
            "acts": self.domain.acts,
            "slots": self.domain.slots,
            "features": model.net.features,
            "known": sorted(model.features.known),
            "threshold": self.threshold,
        }
        arrays = {
            **model.net.arrays(),
            "tagger": np.frombuffer(model.tagger.model, dtype=np.uint8),
            "calibration": self._calibration,
        }
        write_model(Path(path), about, arrays)

    @classmethod
    def load(cls, path: str | Path, domain: Domain) -> Understander:
        """Returns the understander that :meth:`save` wrote.

        Only for a file of your own, or of somebody whom you trust: its checksum finds damage, but a
        file that was made to do harm reaches a library in C, which does not expect it.

        Args:
            path: the file.
            domain: what is spoken of; its acts and slots must be those it was trained for.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: if it is damaged, or of another version or domain.
        """
        about, arrays = read_model(Path(path))
        if (about["acts"], about["slots"]) != (list(domain.acts), list(domain.slots)):
            raise ValueError(
                f"{path} understands the domain {about['domain']!r}, whose acts and slots differ "
                f"from those of {domain.name!r}"
            )
        lexicon = Lexicon(domain)
        net = IntentNet(about["features"], (*domain.acts, FOREIGN.act), domain.slots)
        net.load(arrays)
        tagger = Tagger(arrays["tagger"].tobytes())
        model = Model(Features(lexicon, about["known"]), tagger, net.eval())
        return cls(lexicon, model, arrays["calibration"], about["threshold"])


def same_frame(left: Frame, right: Frame, lexicon: Lexicon) -> bool:
    """Returns whether two frames are equal, values by their canonical keys."""
    return (
        left.act == right.act
        and set(left.requests) == set(right.requests)
        and keys_of(left, lexicon) == keys_of(right, lexicon)
    )


def keys_of(frame: Frame, lexicon: Lexicon) -> dict[str, str]:
    """Returns the canonical key of each value of a frame."""
    return {slot: lexicon.key(slot, value) for slot, value in frame.informs.items()}
