"""The confidence in a frame: the probability that it is right."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch

from bbq_torchrl.domains.frames import Frame
from bbq_torchrl.people.language.words import BREAKS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.people.language.asking import Unclear
    from bbq_torchrl.people.language.model import Reading

_PEOPLE = 10.0  # prior strength of the grammar's weights for people's sentences
_GRAMMAR = 1.0
_WHOLE = 0.2  # log-odds by which the full model is better than those trained on half the lines
CUES = 12


def cues_of(
    words: Sequence[str],
    reading: Reading,
    frame: Frame,
    unclear: Sequence[Unclear],
    *,
    chance: float,
    is_steady: bool,
) -> np.ndarray:
    """Returns the cues for whether a frame is right, ``[CUES]``.

    The log-probability of the tags, of all requests and of all don't-cares, the probability of
    the frame's act, the share of unknown words, whether something is unclear, whether the frame
    stays the same without small words, whether it neither informs nor requests anything, whether
    the words have a question mark, whether they have several clauses, the log-probability that
    they are in the domain, and 1.

    Args:
        words: the words of the sentence.
        reading: the output of the learned parts.
        frame: the frame of the sentence.
        unclear: the words that the frame leaves out.
        chance: the probability of the frame's act.
        is_steady: whether the sentence without its small words has the same frame.
    """
    return np.array(
        [
            math.log(max(reading.tags_chance, 1e-6)),
            _sure(reading.requests),
            _sure(reading.dont_care),
            chance,
            reading.unknown,
            bool(unclear),
            is_steady,
            frame == Frame("inform") and not unclear,
            "?" in words,
            not BREAKS.isdisjoint(words[:-1]),
            math.log(max(1 - reading.foreign, 1e-4)),
            1.0,
        ]
    )


def _sure(chances: torch.Tensor) -> float:
    """Returns the joint log-probability of the more likely outcomes of ``chances``, ``[S]``."""
    return float(torch.maximum(chances, 1 - chances).clamp(min=1e-6).log().sum())


def probability(cues: np.ndarray, weights: np.ndarray) -> float:
    """Returns the probability that a frame is right, given its cues and weights ``[CUES]``."""
    logit = float(cues @ weights)
    return 1.0 / (1.0 + math.exp(-min(max(logit, -30.0), 30.0)))


def fit_confidence(
    grammar: tuple[np.ndarray, np.ndarray], people: tuple[np.ndarray, np.ndarray] | None = None
) -> np.ndarray:
    """Returns the weights ``[CUES]`` of a logistic regression from cues to correctness.

    People's sentences are few, so they only adjust the weights fitted to the grammar's sentences.

    Args:
        grammar: cues ``[N, CUES]`` of the grammar's sentences and whether each was right ``[N]``.
        people: the same for people's sentences, understood by models trained on half of them.
    """
    scale = np.maximum(grammar[0].std(0), 1e-3)
    scale[-1] = 1.0
    weights = _regression(grammar[0] / scale, grammar[1], np.zeros(len(scale)), _GRAMMAR)
    if people is not None:
        weights = _regression(people[0] / scale, people[1], weights, _PEOPLE)
        weights[-1] += _WHOLE
    return weights / scale


def _regression(
    cues: np.ndarray, right: np.ndarray, start: np.ndarray, strength: float
) -> np.ndarray:
    """Returns the maximum a posteriori weights ``[C]``, with a normal prior around ``start``."""
    rows, target = torch.from_numpy(cues), torch.from_numpy(right.astype(np.float64))
    prior = torch.from_numpy(start)
    weights = prior.clone().requires_grad_()
    optimizer = torch.optim.LBFGS([weights], max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimizer.zero_grad()
        value = torch.nn.functional.binary_cross_entropy_with_logits(
            rows @ weights, target, reduction="sum"
        )
        value = value + strength / 2 * (weights - prior).square().sum()
        value.backward()
        return value

    optimizer.step(loss)
    return weights.detach().numpy()
