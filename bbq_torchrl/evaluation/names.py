"""The paper's name of an agent, from its configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

_OF_THE_PAPER = {"bbqn": "BBQN", "bootstrap": "DQN-Bootstrap", "dqn": "DQN"}
"""``agent=`` -> its name. What keys of other agents mean is not known here."""


def agent_name(config: Mapping[str, Any]) -> str:
    """Returns a name such as ``BBQN-MAP`` or ``DQN-VIME-MC``.

    BBQN-VIME-MC stands for targets and information gain both at weight draws; where the two
    differ, both are named. An agent or an intrinsic reward that does not come with the package is
    called by its option's name, in capitals, whatever keys it has.

    Args:
        config: the composed configuration, nested mappings; groups that a version did not have
            yet may be absent.

    Examples:
        >>> agent_name({"agent": {"name": "dqn"}, "explore": {"name": "boltzmann"}})
        'DQN-Boltzmann'
        >>> bbqn = {"agent": {"name": "bbqn", "target": "mc"}, "explore": {"name": "thompson"}}
        >>> agent_name(bbqn | {"intrinsic": {"name": "vime", "weights": "mc"}})
        'BBQN-VIME-MC'
        >>> agent_name({"agent": {"name": "polyak"}, "intrinsic": {"name": "visits"}})
        'POLYAK-VISITS'
    """
    option, intrinsic = str(config["agent"]["name"]), config.get("intrinsic") or {}
    is_known = option in _OF_THE_PAPER
    agent, explore = (config["agent"], config.get("explore") or {}) if is_known else ({}, {})
    target = str(agent["target"]).upper() if agent.get("target") else None
    reward = str(intrinsic.get("name", "none"))
    gain = str(intrinsic["weights"]).upper() if reward == "vime" else None
    name = _OF_THE_PAPER.get(option, option.upper())
    if agent.get("noisy"):
        name = f"Noisy {name}"
    if agent.get("double"):
        name = f"Double {name}"
    parts = [name]
    if explore.get("name") == "boltzmann":
        parts.append("Boltzmann")
    if target is not None and target != gain:
        parts.append(target)
    if reward != "none":
        parts.append(reward.upper())
    if gain is not None:
        parts.append(gain)
    return "-".join(parts)
