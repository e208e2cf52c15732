"""What the exploration strategies share."""

from __future__ import annotations

from typing import Literal

from torchrl.envs.utils import ExplorationType, exploration_type

__all__ = ["Per", "explores"]

Per = Literal["step", "episode", "round"]


def explores() -> bool:
    """Returns whether exploration modules explore: under RANDOM, and outside of any context.

    None counts as RANDOM, as it does for TorchRL's ``EGreedyModule``.
    """
    return exploration_type() in (ExplorationType.RANDOM, None)
