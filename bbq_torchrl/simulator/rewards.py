"""The rewards of a turn."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Rewards:
    """The rewards of a turn (Lipton et al., 2018).

    Args:
        success: for the turn that ends a dialogue in success.
        failure: for the turn that ends a dialogue otherwise, running out of turns included.
        turn: for every other turn.

    Raises:
        ValueError: if a reward is not finite.
    """

    success: float = 40.0
    failure: float = -10.0
    turn: float = -1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise ValueError(f"the reward for {name} must be finite, got {value}")

    def of(
        self, was_done: torch.Tensor, is_done: torch.Tensor, success: torch.Tensor
    ) -> torch.Tensor:
        """Returns the reward of a turn, float32 ``[*B]``; 0 if the dialogue was over before.

        Args:
            was_done: bool ``[*B]``, before the turn.
            is_done: bool ``[*B]``, after the turn.
            success: bool ``[*B]``, whether the turn ends in success.
        """
        at_end = torch.where(success, self.success, self.failure)
        reward = torch.where(was_done, 0.0, torch.where(is_done, at_end, self.turn))
        return reward.float()  # torch.where on numbers returns torch's default dtype
