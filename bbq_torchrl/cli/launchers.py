"""What a sweep's launcher needs."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

from bbq_torchrl.options.settings import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["LAUNCHER", "LAUNCHER_EXTRAS", "check_launcher"]

LAUNCHER = "hydra/launcher"
"""The group of the launchers, Hydra's own."""

LAUNCHER_EXTRAS = {"submitit_slurm": "slurm", "submitit_local": "slurm", "ray": "ray"}
"""Plug-in's option that a launcher of ours extends -> the extra that installs the plug-in."""

_PROGRAMS = {"slurm": "sbatch", "submitit_slurm": "sbatch"}
"""Launcher -> the program that it calls."""


def check_launcher(name: str, settings: Mapping[str, Any]) -> None:
    """Checks that the program a launcher calls is there, and that it may start a process.

    Args:
        name: the option of ``hydra/launcher``.
        settings: its keys.

    Raises:
        ConfigError: it is not, or it may start none.
    """
    if settings.get("n_jobs") == 0:
        raise ConfigError("hydra.launcher.n_jobs must be a number of processes or -1, got 0")
    program = _PROGRAMS.get(name)
    if program is not None and shutil.which(program) is None:
        raise ConfigError(
            f"{LAUNCHER}={name} needs the program {program}, which is not on this machine: "
            f"start the sweep where SLURM's jobs are submitted"
        )
