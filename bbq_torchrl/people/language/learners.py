"""Learned models: the tagger of slots, and the net of acts, questions and don't-cares.

The tagger is a linear-chain conditional random field (python-crfsuite).
"""

from __future__ import annotations

import tempfile
from collections import Counter
from itertools import chain, groupby
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from bbq_torchrl.utils.extras import needed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence


OUTSIDE = "-"
"""The tag of a word that is not part of a value."""

_SURE = 0.6


class Span(NamedTuple):
    """Words that name a value.

    Attributes:
        slot: the slot of the value.
        start: the first word.
        end: the word after the last.
    """

    slot: str
    start: int
    end: int


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
        tick: Callable[[], object] = bool,
    ) -> Tagger:
        """Returns a tagger fitted to sentences.

        Args:
            rows: the features of each word of each sentence.
            tags: the tag of each word of each sentence.
            steps: the maximum number of steps of L-BFGS.
            tick: called after each step.
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
            rows: the features of each word, at least one.
            is_unknown: whether each word is unknown. An unknown word is part of a name unless that
                is unlikely.
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


_WIDTH = 48
_BATCH = 512
_RATE = 0.012
_LEFT_OUT = 0.4
EPOCHS = 10
_MAX_FEATURES = 16_000  # keeps the features that the most sentences have


class IntentNet(nn.Module):
    """A bag of features, one hidden layer, three heads.

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
        self.heads = nn.Linear(_WIDTH, len(self.acts) + 2 * (len(self.slots) + 1))
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
        """Returns the logits of acts ``[B, A]``, requests and don't-cares ``[B, S + 1]``.

        Args:
            flat: the feature ids of sentences, see :meth:`encode`.
            sizes: the number of ids of each sentence.
        """
        starts = sizes.cumsum(0) - sizes
        hidden = self.bag(flat, starts) / sizes.clamp(min=1).sqrt()[:, None]
        hidden = functional.relu(hidden)
        n_acts, n_slots = len(self.acts), len(self.slots) + 1
        return self.heads(hidden).split([n_acts, n_slots, n_slots], -1)

    def _weights(self) -> dict[str, torch.Tensor]:
        return {"bag": self.bag.weight, "heads": self.heads.weight, "bias": self.heads.bias}

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns the weights, those of the features in half precision."""
        arrays = {name: weight.detach().numpy() for name, weight in self._weights().items()}
        return arrays | {"bag": arrays["bag"].astype(np.float16)}

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Loads the weights that :meth:`arrays` returned.

        Raises:
            ValueError: if they are of another shape, or not finite.
        """
        with torch.no_grad():
            for name, weight in self._weights().items():
                given = torch.from_numpy(np.array(arrays[name], dtype=np.float32))
                if given.shape != weight.shape or not bool(given.isfinite().all()):
                    raise ValueError(
                        f"the weights {name} must be finite, of shape {list(weight.shape)}, "
                        f"got {list(given.shape)}"
                    )
                weight.copy_(given)


def train_intents(
    sentences: Sequence[Sequence[str]],
    acts: Sequence[int],
    requests: torch.Tensor,
    dont_care: torch.Tensor,
    names: tuple[Sequence[str], Sequence[str]],
    *,
    seed: int,
    tick: Callable[[], object] = bool,
) -> IntentNet:
    """Returns a net fitted to sentences.

    Args:
        sentences: the features of each sentence.
        acts: the act of each sentence.
        requests: float ``[N, S + 1]``.
        dont_care: float ``[N, S + 1]``.
        names: the acts and the slots.
        seed: the seed of the initial weights, the order and the dropped features.
        tick: called after each epoch.
    """
    count = Counter(chain.from_iterable(map(set, sentences)))
    ranked = sorted(
        (item for item in count.items() if item[1] > 1), key=lambda item: (-item[1], item[0])
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        net = IntentNet([name for name, _ in ranked[:_MAX_FEATURES]], *names)
        flat, sizes = net.encode(sentences)
        starts = sizes.cumsum(0) - sizes
        target = torch.tensor(acts)
        optimizer = torch.optim.Adam(net.parameters(), lr=_RATE, fused=True)
        steps = EPOCHS * (-(-len(sizes) // _BATCH))
        schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.05, steps)
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(sizes)).split(_BATCH):
                own = sizes[rows]
                shift = starts[rows] - own.cumsum(0) + own
                places = shift.repeat_interleave(own) + torch.arange(int(own.sum()))
                is_kept = torch.rand(len(places)) > _LEFT_OUT
                owner = torch.arange(len(rows)).repeat_interleave(own)[is_kept]
                kept = torch.bincount(owner, minlength=len(rows))
                act, request, care = net(flat[places[is_kept]], kept)
                loss = (
                    functional.cross_entropy(act, target[rows], label_smoothing=0.02)
                    + 25 * functional.binary_cross_entropy_with_logits(request, requests[rows])
                    + 15 * functional.binary_cross_entropy_with_logits(care, dont_care[rows])
                )
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
            tick()
        net.bag.weight.data = net.bag.weight.data.half().float()
    return net.eval()
