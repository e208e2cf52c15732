"""How simulated users rate."""

from __future__ import annotations

from random import Random

from bbq_torchrl.people.study.records import SCALES

RATING_RULE = (
    "Their own verdict is whether they have got what they wanted, as far as they know. Their "
    "ratings are drawn, each scale by itself: 4.5 after a yes and 2 after a no, less 0.1 for every "
    "message beyond the fifth, plus normal noise of standard deviation 0.75, rounded, from 1 to 5. "
    "So ratings say nothing that verdict and length do not."
)
"""What reports of simulated studies tell of :func:`drawn_ratings`."""


def drawn_ratings(satisfied: bool, messages: int, seed: int) -> dict[str, int]:
    """Returns a simulated user's ratings, by scale.

    Args:
        satisfied: its own verdict.
        messages: how many it has sent.
        seed: of the noise.
    """
    rng, middle = Random(seed), (4.5 if satisfied else 2.0) - 0.1 * max(0, messages - 5)
    return {name: min(5, max(1, round(rng.gauss(middle, 0.75)))) for name in SCALES}
