"""The commit that the package runs from, where it runs from a git checkout."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import NamedTuple

import bbq_torchrl

_SECONDS = 30.0  # a network drive is slow, but a run must not wait for its commit forever


class Checkout(NamedTuple):
    """The state of the code.

    Attributes:
        commit: the hash of the commit that is checked out; None outside of a checkout.
        clean: whether the working tree is as committed, by ``git status``; None if unknown.
    """

    commit: str | None = None
    clean: bool | None = None


def checkout(folder: Path | None = None) -> Checkout:
    """Returns the commit of a package's code, and whether the working tree is clean.

    Args:
        folder: of the package, this one by default. If git does not track its ``__init__.py``, it
            was installed from elsewhere, perhaps below another project's checkout.
    """
    folder = Path(bbq_torchrl.__file__).parent if folder is None else folder
    if _git(folder, "ls-files", "--error-unmatch", "__init__.py") is None:
        return Checkout()
    commit = _git(folder, "rev-parse", "--verify", "HEAD")
    if commit is None:
        return Checkout()
    status = _git(folder, "status", "--porcelain")
    return Checkout(commit, None if status is None else not status)


def _git(folder: Path, *command: str) -> str | None:
    """Returns what git prints; None if there is no git, or it fails."""
    # GIT_DIR and the like, set where a hook starts a run, would name another repository.
    environment = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    try:
        # Without locks: jobs that start together must not get in each other's way.
        done = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(folder), *command],
            capture_output=True,
            check=True,
            encoding="utf-8",
            errors="replace",
            env=environment,
            stdin=subprocess.DEVNULL,
            timeout=_SECONDS,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
