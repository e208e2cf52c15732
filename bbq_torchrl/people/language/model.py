"""The two learned parts of the nlu, and their training."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.language.asking import FOREIGN, asked_slot
from bbq_torchrl.people.language.learners import OUTSIDE, IntentNet, Tagger, train_intents
from bbq_torchrl.people.language.sentence_features import UNKNOWN, Features
from bbq_torchrl.people.language.words import BREAKS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bbq_torchrl.people.language.corpus import Example
    from bbq_torchrl.people.language.lexicon import Lexicon

_MAX_CLAUSES = 6
_SURE = 0.75


@dataclass(frozen=True)
class Reading:
    """The output of the learned parts for one sentence.

    Attributes:
        tags: the best tag of each word.
        tags_chance: their probability.
        each_chance: the probability of each tag.
        acts: the log-probability of each act, ``[A]``.
        requests: the probability that each slot is asked for, ``[S]``.
        dont_care: the probability that each slot does not matter, ``[S]``.
        unknown: the share of words that no training sentence has.
        foreign: the probability that the sentence is out of domain; with several clauses, its mean
            with that of the first.
    """

    tags: list[str]
    tags_chance: float
    each_chance: list[float]
    acts: torch.Tensor
    requests: torch.Tensor
    dont_care: torch.Tensor
    unknown: float
    foreign: float = 0.0


@dataclass(frozen=True)
class Model:
    """The tagger, the net and their features."""

    features: Features
    tagger: Tagger
    net: IntentNet

    @torch.no_grad()
    def read(
        self, words: Sequence[str], question: Frame, capitals: frozenset[str] = frozenset()
    ) -> Reading:
        """Returns the reading of a sentence of at least one word."""
        tags, chance, each = _tagged(self.tagger, self.features, words, question, capitals)
        parts = [(words, tags), *_clauses(words, tags)]
        named = [self.features.of_sentence(*part, question) for part in parts]
        acts, requests, dont_care = self.net(*self.net.encode(named))
        slot = asked_slot(question)
        asked = self.net.slots.index(slot) if slot in self.net.slots else None
        asks = _of_slots(requests[0], asked)
        for row in requests[1:]:
            clause = _of_slots(row, None)  # counts only where it is sure
            asks = torch.where(clause > _SURE, torch.maximum(asks, clause), asks)
        return Reading(
            tags,
            chance,
            each,
            # By the labeling guide, the act of a sentence is that of its first clause.
            acts[:, :-1].log_softmax(-1)[:2].mean(0).log_softmax(-1),
            asks,
            _of_slots(dont_care[0], asked),
            self.features.share_unknown(words),
            acts[:2].softmax(-1)[:, -1].mean().item(),
        )


def _tagged(
    tagger: Tagger,
    features: Features,
    words: Sequence[str],
    question: Frame,
    capitals: frozenset[str] = frozenset(),
) -> tuple[list[str], float, list[float]]:
    """Returns the result of :meth:`Tagger.__call__` for a sentence."""
    is_unknown = [features.spelled(word) == UNKNOWN for word in words]
    return tagger(features.of_words(words, question, capitals), is_unknown)


def _clauses(
    words: Sequence[str], tags: Sequence[str]
) -> list[tuple[Sequence[str], Sequence[str]]]:
    """Returns the clauses of a sentence with their tags; empty if there is only one."""
    pairs = enumerate(zip(words, tags, strict=True))
    cuts = [at for at, (word, tag) in pairs if word in BREAKS and tag == OUTSIDE]
    bounds = [-1, *cuts, len(words)]
    found = [
        (words[start + 1 : end], tags[start + 1 : end])
        for start, end in pairwise(bounds)
        if end - start > 1
    ]
    return found[:_MAX_CLAUSES] if len(found) > 1 else []


def _of_slots(logits: torch.Tensor, asked: int | None) -> torch.Tensor:
    """Returns the probabilities of slots ``[S]``; the last logit is for the slot asked for."""
    chances = logits.sigmoid()
    slots = chances[:-1].clone()
    if asked is not None:
        slots[asked] = torch.maximum(slots[asked], chances[-1])
    return slots


def fit(
    lexicon: Lexicon,
    examples: Sequence[Example],
    simulated: Sequence[Example],
    foreign: Sequence[Example],
    *,
    seed: int,
    steps: int,
    tick: Callable[[], object] = bool,
) -> Model:
    """Returns a model fitted to sentences; equal arguments give bit-identical models.

    Args:
        lexicon: the names, and the domain whose acts and slots are read.
        examples: the sentences.
        simulated: further sentences that only the net learns from.
        foreign: the same, but out of domain; the tagger tags them.
        seed: the seed of the net.
        steps: the maximum number of steps of the tagger's optimizer.
        tick: called after each of these steps, and after each epoch of the net.
    """
    domain = lexicon.domain
    words = Counter(
        w for e in examples for w, t in zip(e.words, e.tags, strict=True) if t == OUTSIDE
    )
    known = [word for word, count in words.items() if count > 1]
    features = Features(lexicon, known)
    # "Friday or Saturday" informs neither, but must not teach that these are not names.
    named = [e for e in examples if e.frame != Frame("inform") or {*e.tags} != {OUTSIDE}]
    tagger = Tagger.train(
        [features.of_words(e.words, e.question, e.capitals) for e in named],
        [e.tags for e in named],
        steps,
        tick,
    )
    slots, acts = domain.slots, (*domain.acts, FOREIGN.act)
    examples = [*examples, *simulated]
    for example in foreign:  # their unknown words are not names, but may be taken for one
        tags, _, _ = _tagged(tagger, features, example.words, example.question)
        examples.append(replace(example, tags=tags))
    requests = torch.zeros(len(examples), len(slots) + 1)
    dont_care = torch.zeros(len(examples), len(slots) + 1)
    for row, example in enumerate(examples):
        frame, asked = example.frame, asked_slot(example.question)
        for target, own in ((requests, frame.requests), (dont_care, frame.dont_care)):
            for slot in own:
                # "Any" means the slot asked for; "any city" means the city whatever was asked.
                target[row, len(slots) if slot == asked else slots.index(slot)] = 1.0
    net = train_intents(
        [features.of_sentence(e.words, e.tags, e.question) for e in examples],
        [acts.index(e.frame.act) for e in examples],
        requests,
        dont_care,
        (acts, slots),
        seed=seed,
        tick=tick,
    )
    return Model(features, tagger, net)
