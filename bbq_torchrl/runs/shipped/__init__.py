"""Trained agents that come with the package, used as ``shipped:<name>`` instead of a run folder.

Each is a folder here with the configuration, the result, the command line, and a checkpoint of the
Q-network's weights in half precision. ``scripts/ship_agent.py`` makes it from a finished run.
"""

from __future__ import annotations

from os.path import expanduser
from pathlib import Path

from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils.text import shown

__all__ = ["SHIPPED", "is_shipped", "run_folder", "shipped_agents"]

SHIPPED = Path(__file__).resolve().parent
"""The folder of the shipped agents."""

PREFIX = "shipped:"


def shipped_agents() -> list[str]:
    """Returns the names of the shipped agents."""
    return sorted(file.parent.name for file in SHIPPED.glob("*/config.yaml"))


def run_folder(place: Path | str, base: Path | None = None) -> Path:
    """Returns the folder of a shipped agent, or a run folder.

    Args:
        place: ``shipped:<name>`` or a path.
        base: the folder that relative paths start from. Defaults to the working directory.

    Raises:
        ConfigError: no shipped agent has that name.

    Examples:
        >>> run_folder("shipped:bbqn_map").name
        'bbqn_map'
    """
    text = str(place)
    if not text.startswith(PREFIX):
        return (base or Path()) / Path(expanduser(place))
    name, known = text.removeprefix(PREFIX), shipped_agents()
    if name not in known:
        raise ConfigError(f"{PREFIX}<name> must name one of {', '.join(known)}, got {shown(text)}")
    return SHIPPED / name


def is_shipped(folder: Path) -> bool:
    """Returns whether a folder belongs to a shipped agent."""
    return folder.resolve().parent == SHIPPED
