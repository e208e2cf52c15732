"""What a sweep's launcher needs."""

from __future__ import annotations

import shutil

from bbq_torchrl.options.settings import ConfigError

__all__ = ["LAUNCHER", "LAUNCHER_EXTRAS", "check_launcher"]

LAUNCHER = "hydra/launcher"
"""The group of the launchers, Hydra's own."""

LAUNCHER_EXTRAS = {"submitit_slurm": "slurm", "submitit_local": "slurm", "ray": "ray"}
"""Plug-in's option that a launcher of ours extends -> the extra that installs the plug-in."""

_PROGRAMS = {"slurm": "sbatch", "submitit_slurm": "sbatch"}
"""Launcher -> the program that it calls."""


def check_launcher(name: str) -> None:
    """Checks that the program a launcher calls is there.

    Args:
        name: the option of ``hydra/launcher``.

    Raises:
        ConfigError: it is not.
    """
    program = _PROGRAMS.get(name)
    if program is not None and shutil.which(program) is None:
        raise ConfigError(
            f"{LAUNCHER}={name} needs the program {program}, which is not on this machine: "
            f"start the sweep where SLURM's jobs are submitted"
        )
