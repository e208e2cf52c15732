"""Reproducible random choices."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Sequence

T = TypeVar("T")


class Dice:
    """Random choices that are the same in every version of Python.

    Of the standard generator only ``random()`` is promised never to change, so all is built on it.
    """

    def __init__(self, seed: int) -> None:
        self.uniform = random.Random(seed).random

    def chance(self, probability: float) -> bool:
        """Returns True with the probability given."""
        return self.uniform() < probability

    def pick(self, items: Sequence[T]) -> T:
        """Returns one of the items, all equally likely."""
        return items[int(self.uniform() * len(items))]

    def pick_early(self, items: Sequence[T], exponent: float = 1.0) -> T:
        """Returns one of the items, the i-th with a weight of ``i ** -exponent`` (Zipf's law)."""
        weights = [(index + 1) ** -exponent for index in range(len(items))]
        rest = self.uniform() * math.fsum(weights)
        for item, weight in zip(items, weights, strict=True):
            rest -= weight
            if rest < 0:
                return item
        return items[-1]

    def shuffle(self, items: Sequence[T]) -> list[T]:
        """Returns the items in a random order."""
        keyed = [(self.uniform(), index) for index in range(len(items))]
        return [items[index] for _, index in sorted(keyed)]

    def sample(self, items: Sequence[T], count: int) -> list[T]:
        """Returns up to ``count`` different items in a random order."""
        return self.shuffle(items)[:count]
