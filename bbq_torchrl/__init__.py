"""BBQ-Networks (AAAI 2018) as native TorchRL parts.

The sub-packages bear TorchRL's names: ``envs``, ``modules``, ``objectives``, ``data``,
``trainers``. ``domains`` and ``simulator`` hold what a dialogue is about and how the user in it
behaves; ``evaluation`` measures trained agents; ``options`` are what the command line can choose.
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
