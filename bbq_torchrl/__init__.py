"""BBQ-Networks (AAAI 2018) as native TorchRL parts.

``bayes``, ``networks``, ``exploration``, ``objectives``, ``data`` and ``vime`` are parts for any
TorchRL project; ``domains`` and ``simulator`` hold what a dialogue is about and how the user in it
behaves, ``envs`` makes an environment of them; ``trainers`` play and learn, ``evaluation`` measures
trained agents, and ``options`` are what the command line can choose.
:func:`train` trains an agent as the command line does; :func:`load_run` returns a finished run as
environment, policy and configuration; :func:`config_dir` is for Hydra's Compose API.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from bbq_torchrl import interruption

if TYPE_CHECKING:
    from bbq_torchrl.runs.loading import load_run
    from bbq_torchrl.runs.notebook import config_dir, train

__all__ = ["__version__", "config_dir", "load_run", "train"]

__version__ = "0.2.0.dev0"

if sys.argv[:1] == ["-m"] and f"{__name__}." in " ".join(sys.orig_argv):
    # `python -m` is about to run one of our modules, whose packages take seconds to import: Ctrl-C
    # in these ends in a line, too.
    interruption.listen()


def __getattr__(name: str) -> Any:
    # Imported when it is asked for: torch and torchrl take seconds.
    if name == "load_run":
        from bbq_torchrl.runs.loading import load_run

        return load_run
    if name in ("config_dir", "train"):
        from bbq_torchrl.runs import notebook

        return getattr(notebook, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
