"""Which exploration strategies an agent can use: a table, read by checks, help text and docs."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["EXPLORATIONS", "explorations_table"]

EXPLORATIONS: Mapping[str, tuple[str, ...]] = {
    "bbqn": ("thompson", "thompson_epsilon", "epsilon_greedy", "boltzmann", "greedy"),
    "dqn": ("epsilon_greedy", "boltzmann", "greedy", "noisy"),
    "bootstrap": ("bootstrap", "epsilon_greedy", "greedy"),
}
"""agent -> the strategies it can use, its default first.

Thompson sampling needs a posterior, bootstrap heads, noisy ``agent.noisy=true``. The greedy action
of a bootstrap agent, ε-greedy's too, is what most heads vote for: there is no value to be put into
a softmax, so boltzmann is refused.
"""


def explorations_table() -> str:
    """The table as text, one line an agent.

    Example:
        >>> print(explorations_table().splitlines()[2])
        agent=bootstrap  explore=bootstrap (default), epsilon_greedy, greedy
    """
    width = max(map(len, EXPLORATIONS))
    return "\n".join(
        f"agent={agent:<{width}}  explore={options[0]} (default), {', '.join(options[1:])}"
        for agent, options in EXPLORATIONS.items()
    )
