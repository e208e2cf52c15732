"""BBQ-Networks (AAAI 2018) as native TorchRL parts.

``bayes``, ``networks``, ``exploration``, ``objectives``, ``data`` and ``vime`` are parts for any
TorchRL project. ``domains`` and ``simulator`` define dialogues and their users, and ``envs`` makes
environments of them. ``trainers`` collect and learn, ``evaluation`` measures trained agents, and
``options`` are the choices of the command line.
:func:`train` trains an agent as the command line does; :func:`load_run` returns a finished run as
environment, policy and configuration; :func:`config_dir` is for Hydra's Compose API.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bbq_torchrl.runs.loading import config_dir, load_run, train

__all__ = ["__version__", "config_dir", "load_run", "train"]

__version__ = "0.3.0"

# TorchRL logs to standard output, which is for results.
os.environ.setdefault("TORCHRL_CONSOLE_STREAM", "stderr")


def __getattr__(name: str) -> Any:
    # Imported on first use, since torch and torchrl take seconds.
    if name in ("config_dir", "load_run", "train"):
        from bbq_torchrl.runs import loading

        return getattr(loading, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
