"""From a user's text to a frame with values of the domain."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from bbq_torchrl.people.language.asking import FOREIGN, OPENING, Understood
from bbq_torchrl.people.language.assembly import assemble
from bbq_torchrl.people.language.confidence import CUES, cues_of, fit_confidence, probability
from bbq_torchrl.people.language.corpus import make_examples, spoiled
from bbq_torchrl.people.language.learners import EPOCHS, OUTSIDE, IntentNet, Tagger
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.model import Model, fit
from bbq_torchrl.people.language.model_file import read_model, write_model
from bbq_torchrl.people.language.paraphrase import DROPPED, Surfaces
from bbq_torchrl.people.language.sentence_features import Features
from bbq_torchrl.people.language.training_lines import (
    DRILLED_FILE,
    LEARNED_FILE,
    as_examples,
    lines_of,
    make_foreign,
    varied,
)
from bbq_torchrl.people.language.words import capitalized, words_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.domains.frames import Frame
    from bbq_torchrl.people.language.asking import Unclear
    from bbq_torchrl.people.language.corpus import Example
    from bbq_torchrl.people.language.training_lines import Line

SENTENCES = 7_200
"""The maximum number of people's sentences to learn from."""

THRESHOLD = 0.75
"""The confidence below which to ask again: .8 of unseen writers' sentences are above it."""

_STEPS, _BLIND_STEPS = 40, 30  # of the tagger's optimizer

TICKS = _STEPS + _BLIND_STEPS + 2 * EPOCHS
"""The maximum number of steps of learning."""

_MAX_WORDS = 120
_CALM = 0.3  # of noise: the grammar's sentences are more crowded than people's
_OWN = 4  # at least one of the grammar's sentences to this many others
_PLAYED = 4  # simulated users' sentences to one of the others
_TAGGED = 16  # the tagger learns from one in this many of these
_COPIES = 4  # of each of people's sentences, with other values, at most
_UNKNOWN = 4  # one in this many of the grammar's sentences is also learned with other values
_FOREIGN = 2  # people's sentences to one out-of-domain sentence
_SHARE = 4  # the smaller model learns from one in this many of the grammar's sentences


class Understander:
    """Understands users of a domain.

    Args:
        lexicon: the domain's phrases and values.
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
        """Returns an understander trained on sentences of the domain's grammar.

        Equal arguments give bit-identical results. Torch runs on one thread during training.

        Args:
            domain: the domain. Its folder may have a ``language.yaml`` and people's labeled lines,
                which are learned with the grammar's sentences: ``learned.txt``, as people type,
                and ``drilled.txt``, written for hard cases. The confidence is fitted to a quarter
                of the former, as understood by a smaller model trained on half of it.
            sentences: the maximum number of people's sentences to learn from. The grammar's
                sentences make up the rest, and are at least a quarter as many. Simulated users'
                sentences are four times as many, most of them for the net alone.
            seed: the seed of the sentences and of the net's initial weights.
            labeled: people's labeled lines, learned like ``learned.txt``.
            threshold: the confidence below which the caller should ask again.
            tick: called after each step of learning, at most :data:`TICKS` times.

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
                # The confidence is fitted to people's sentences that the model has not seen.
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
            text: the user's text.
            question: the agent's last act; ``None`` at the opening.

        Raises:
            TextError: a ``ValueError`` fit to be shown, if nothing of the text can be read or it
                is too long.
        """
        words = words_of(text)[:_MAX_WORDS]
        frame, unclear, cues = self._hear(words, question or OPENING, capitalized(text))
        return Understood(frame, probability(cues, self._calibration), unclear)

    def asks(self, understood: Understood) -> bool:
        """Returns whether the system should ask again instead of acting."""
        return understood.confidence < self.threshold or bool(understood.unclear)

    def _hear(
        self, words: Sequence[str], question: Frame, capitals: frozenset[str]
    ) -> tuple[Frame, tuple[Unclear, ...], np.ndarray]:
        """Returns the frame of some words, the unclear words, and the cues of its confidence."""
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
        """Returns the cues ``[N, CUES]`` of sentences, and whether each frame is right ``[N]``."""
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

        Load only your own files, or those of somebody you trust: the checksum detects damage, but a
        malicious file reaches a C library that does not expect it.

        Args:
            path: the file.
            domain: the domain; its acts and slots must be those that it was trained for.

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
    """Returns whether two frames are equal, comparing values by their canonical keys."""
    return (
        left.act == right.act
        and set(left.requests) == set(right.requests)
        and keys_of(left, lexicon) == keys_of(right, lexicon)
    )


def keys_of(frame: Frame, lexicon: Lexicon) -> dict[str, str]:
    """Returns the canonical key of each value of a frame."""
    return {slot: lexicon.key(slot, value) for slot, value in frame.informs.items()}
