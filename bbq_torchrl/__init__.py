"""BBQ-Networks (AAAI 2018) as native TorchRL parts.

``bayes``, ``networks``, ``exploration``, ``objectives``, ``data`` and ``vime`` are parts for any
TorchRL project; ``domains`` and ``simulator`` hold what a dialogue is about and how the user in it
behaves, ``envs`` makes an environment of them; ``trainers`` play and learn, ``evaluation`` measures
trained agents, and ``options`` are what the command line can choose.
:func:`load_run` returns a finished run as environment, policy and configuration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bbq_torchrl.cli.loading import load_run

__all__ = ["__version__", "load_run"]

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    # Imported when it is asked for: torch and torchrl take seconds.
    if name == "load_run":
        from bbq_torchrl.cli.loading import load_run

        return load_run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
