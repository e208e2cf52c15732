"""What the paper calls an agent, from the configuration that composes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["agent_name"]


def agent_name(config: Mapping[str, Any]) -> str:
    """Returns a name such as ``BBQN-MAP`` or ``DQN-VIME-MC``.

    BBQN-VIME-MC stands for targets and information gain both at weight draws; where the two
    differ, both are named.

    Args:
        config: the composed configuration, nested mappings; groups that a version did not have
            yet may be absent.

    Examples:
        >>> agent_name({"agent": {"name": "dqn"}, "explore": {"name": "boltzmann"}})
        'DQN-Boltzmann'
        >>> bbqn = {"agent": {"name": "bbqn", "target": "mc"}, "explore": {"name": "thompson"}}
        >>> agent_name(bbqn | {"intrinsic": {"name": "vime", "weights": "mc"}})
        'BBQN-VIME-MC'
    """
    agent, intrinsic = config["agent"], config.get("intrinsic") or {}
    explore = (config.get("explore") or {}).get("name")
    target = str(agent["target"]).upper() if agent.get("target") else None
    gain = str(intrinsic["weights"]).upper() if intrinsic.get("name") == "vime" else None
    name = "DQN-Bootstrap" if agent["name"] == "bootstrap" else str(agent["name"]).upper()
    if agent.get("noisy"):
        name = f"Noisy {name}"
    if agent.get("double"):
        name = f"Double {name}"
    parts = [name]
    if explore == "boltzmann":
        parts.append("Boltzmann")
    if target is not None and target != gain:
        parts.append(target)
    if gain is not None:
        parts += ["VIME", gain]
    return "-".join(parts)
