"""The learned parts of the nlu, and their training: a tagger of slots, and a net of acts and slots.

The tagger is a linear-chain conditional random field (python-crfsuite).
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import NoReturn

import torch
from torch import nn
from torch.nn import functional
from tqdm import tqdm

from bbq_torchrl.domains import Domain
from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.language.asking import FOREIGN, asked_slot
from bbq_torchrl.people.language.corpus import Example
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.sentence_features import UNKNOWN, Features
from bbq_torchrl.people.language.words import OUTSIDE
from bbq_torchrl.utils.output import needed


class Tagger:
    """Tags words by their features.

    Args:
        model: the random field in crfsuite's format.
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
    ) -> Tagger:
        """Returns a tagger fitted to sentences.

        Args:
            rows: the features of each word of each sentence.
            tags: the tag of each word of each sentence.
            steps: the maximum number of steps of L-BFGS.
        """
        trainer = needed("python-crfsuite", "pycrfsuite").Trainer()
        for row, own in zip(rows, tags, strict=True):
            trainer.append(row, own)
        trainer.set_params({"c1": 0.05, "c2": 0.02, "max_iterations": steps, "feature.minfreq": 2})
        with tempfile.TemporaryDirectory() as folder, _progress("learning words", steps) as bar:
            trainer.message = lambda text: bar.update("Iteration #" in text)
            path = Path(folder) / "tagger.crf"
            trainer.train(str(path))
            return cls(path.read_bytes())

    def __call__(self, rows: Sequence[Sequence[str]]) -> tuple[list[str], float]:
        """Returns the best tags of a sentence, and their probability.

        Args:
            rows: the features of each word, at least one.
        """
        tags = self._tagger.tag(rows)
        return tags, self._tagger.probability(tags)


def _progress(what: str, steps: int) -> tqdm[NoReturn]:
    """Returns a progress bar, which only a terminal shows."""
    return tqdm(total=steps, desc=what, disable=None, leave=False)


_WIDTH = 48
_BATCH = 512
_RATE = 0.012
_LEFT_OUT = 0.4
_EPOCHS = 10
_MAX_FEATURES = 16_000  # keeps the features that the most sentences have


class IntentNet(nn.Module):
    """A bag of features, one hidden layer, four heads.

    Args:
        features: the known features; others are ignored.
        acts: the acts.
        slots: the slots; each head over slots has one more output, for the slot asked for last.
    """

    def __init__(self, features: Sequence[str], acts: Sequence[str], slots: Sequence[str]) -> None:
        super().__init__()
        self.features, self.acts, self.slots = tuple(features), tuple(acts), tuple(slots)
        self._index = {name: index for index, name in enumerate(self.features)}
        self.bag = nn.EmbeddingBag(len(self.features), _WIDTH, mode="sum")
        self.heads = nn.Linear(_WIDTH, len(self.acts) + 2 * (len(self.slots) + 1) + 1)
        nn.init.normal_(self.bag.weight, std=0.05)

    def encode(self, sentences: Iterable[Iterable[str]]) -> tuple[torch.Tensor, torch.Tensor]:
        """Returns the feature ids of sentences.

        Args:
            sentences: the feature names of each sentence.

        Returns:
            The ids of all sentences, concatenated, long, and their number in each, long ``[B]``.
        """
        index = self._index
        bags = [sorted({index[name] for name in names if name in index}) for names in sentences]
        flat = torch.tensor(list(chain.from_iterable(bags)), dtype=torch.long)
        return flat, torch.tensor([len(bag) for bag in bags])

    def forward(self, flat: torch.Tensor, sizes: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Returns logits: acts ``[B, A]``, requests, don't-cares ``[B, S + 1]``, yes ``[B, 1]``.

        Args:
            flat: the feature ids of sentences, see :meth:`encode`.
            sizes: the number of ids of each sentence.
        """
        starts = sizes.cumsum(0) - sizes
        hidden = self.bag(flat, starts) / sizes.clamp(min=1).sqrt()[:, None]
        hidden = functional.relu(hidden)
        n_acts, n_slots = len(self.acts), len(self.slots) + 1
        return self.heads(hidden).split([n_acts, n_slots, n_slots, 1], -1)


def _fitted_net(
    examples: Sequence[Example], features: Features, domain: Domain, seed: int
) -> IntentNet:
    """Returns a net fitted to sentences; the seed is that of weights, order and dropout."""
    sentences = [features.of_sentence(e.words, e.tags, e.question) for e in examples]
    slots, acts = domain.slots, (*domain.acts, FOREIGN.act)
    target = torch.tensor([acts.index(example.frame.act) for example in examples])
    takes = torch.tensor([[float(example.takes)] for example in examples])
    requests, dont_care = torch.zeros(2, len(examples), len(slots) + 1)
    for row, example in enumerate(examples):
        frame, asked = example.frame, asked_slot(example.question)
        for flags, named in ((requests, frame.requests), (dont_care, frame.dont_care)):
            for slot in named:
                # "Any" means the slot asked for; "any city" means the city whatever was asked.
                flags[row, len(slots) if slot == asked else slots.index(slot)] = 1.0
    count = Counter(chain.from_iterable(map(set, sentences)))
    ranked = sorted(
        (item for item in count.items() if item[1] > 1), key=lambda item: (-item[1], item[0])
    )
    with torch.random.fork_rng(devices=[]), _progress("learning acts", _EPOCHS) as bar:
        torch.manual_seed(seed)
        net = IntentNet([name for name, _ in ranked[:_MAX_FEATURES]], acts, slots)
        flat, sizes = net.encode(sentences)
        starts = sizes.cumsum(0) - sizes
        optimizer = torch.optim.Adam(net.parameters(), lr=_RATE, fused=True)
        steps = _EPOCHS * (-(-len(sizes) // _BATCH))
        schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.05, steps)
        for _ in range(_EPOCHS):
            for rows in torch.randperm(len(sizes)).split(_BATCH):
                own = sizes[rows]
                shift = starts[rows] - own.cumsum(0) + own
                places = shift.repeat_interleave(own) + torch.arange(int(own.sum()))
                is_kept = torch.rand(len(places)) > _LEFT_OUT
                owner = torch.arange(len(rows)).repeat_interleave(own)[is_kept]
                kept = torch.bincount(owner, minlength=len(rows))
                act, request, care, taking = net(flat[places[is_kept]], kept)
                loss = (
                    functional.cross_entropy(act, target[rows], label_smoothing=0.02)
                    + 25 * functional.binary_cross_entropy_with_logits(request, requests[rows])
                    + 15 * functional.binary_cross_entropy_with_logits(care, dont_care[rows])
                    + functional.binary_cross_entropy_with_logits(taking, takes[rows])
                )
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
            bar.update()
        net.bag.weight.data = net.bag.weight.data.half().float()
    return net.eval()


@dataclass(frozen=True)
class Reading:
    """The output of the learned parts for one sentence.

    Attributes:
        tags: the best tag of each word.
        tags_chance: their probability.
        is_unknown: whether each word is neither of a name nor of the training sentences.
        acts: the log-probability of each act, ``[A]``.
        requests: the probability that each slot is asked for, ``[S]``.
        dont_care: the probability that each slot does not matter, ``[S]``.
        foreign: the probability that the sentence is out of domain.
        takes: the probability that it takes what the agent offers or proposes.
    """

    tags: list[str]
    tags_chance: float
    is_unknown: list[bool]
    acts: torch.Tensor
    requests: torch.Tensor
    dont_care: torch.Tensor
    foreign: float = 0.0
    takes: float = 0.0


@dataclass(frozen=True)
class Model:
    """The tagger, the net and their features."""

    features: Features
    tagger: Tagger
    net: IntentNet

    @torch.no_grad()
    def read(self, words: Sequence[str], question: Frame) -> Reading:
        """Returns the reading of a sentence of at least one word."""
        tags, chance = self.tagger(self.features.of_words(words, question))
        named = self.features.of_sentence(words, tags, question)
        acts, requests, dont_care, takes = self.net(*self.net.encode([named]))
        slot = asked_slot(question)
        asked = self.net.slots.index(slot) if slot in self.net.slots else None
        return Reading(
            tags,
            chance,
            [self.features.spelled(word) == UNKNOWN for word in words],
            acts[0, :-1].log_softmax(-1),
            _of_slots(requests[0], asked),
            _of_slots(dont_care[0], asked),
            acts[0].softmax(-1)[-1].item(),
            takes.sigmoid().item(),
        )


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
) -> Model:
    """Returns a model fitted to sentences; equal arguments give bit-identical models.

    Args:
        lexicon: the names, and the domain whose acts and slots are read.
        examples: the sentences.
        simulated: further sentences that only the net learns from.
        foreign: the same, but out of domain; the tagger tags them.
        seed: the seed of the net.
        steps: the maximum number of steps of the tagger's optimizer.
    """
    words = Counter(
        w for e in examples for w, t in zip(e.words, e.tags, strict=True) if t == OUTSIDE
    )
    known = [word for word, count in words.items() if count > 1]
    features = Features(lexicon, known)
    # "Friday or Saturday" informs neither, but must not teach that these are not names.
    named = [e for e in examples if e.frame != Frame("inform") or {*e.tags} != {OUTSIDE}]
    rows = [features.of_words(e.words, e.question) for e in named]
    tagger = Tagger.train(rows, [e.tags for e in named], steps)
    examples = [*examples, *simulated]
    for example in foreign:  # their unknown words are not names, but may be taken for one
        tags, _ = tagger(features.of_words(example.words, example.question))
        examples.append(replace(example, tags=tags))
    net = _fitted_net(examples, features, lexicon.domain, seed)
    return Model(features, tagger, net)
