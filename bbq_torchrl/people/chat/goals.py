"""What a person is to get out of a chat, and whether it did."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

from bbq_torchrl.options import ConfigError
from bbq_torchrl.people.dialogue.judge import Judge

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain, Goal

REASONS = {
    "no offer": "no booking was offered",
    "wishes": "the last offer did not hold all of your wishes",
    "no ticket": "the last offer was not available",
    "questions": "not every question was answered with what the booking has",
    "no match left": "something was said to be without a match, and left so",
    "out of turns": "it ran out of turns",
}
"""A judge's reason, in a clause."""


def choose_goal(domain: Domain, number: int | None, seed: int) -> Goal:
    """Returns a goal of the domain.

    Args:
        domain: whose goals.
        number: which one, from 1; ``None`` draws one that some record can meet.
        seed: of the draw.

    Raises:
        ConfigError: there is no such goal, or none that can be met.
    """
    goals = domain.goals
    if number is not None:
        if not 1 <= number <= len(goals):
            raise ConfigError(f"--goal must be between 1 and {len(goals)}, got {number}")
        return goals[number - 1]
    judge = Judge(domain)
    attainable = [goal for goal in goals if judge.is_attainable(goal)]
    if not attainable:
        raise ConfigError(f"no goal of the domain {domain.name} can be met: use --free")
    return random.Random(seed).choice(attainable)
