"""Import paths of 0.1 that have moved: they work until 0.3, with a DeprecationWarning."""

from __future__ import annotations

import importlib
import sys
import warnings
from types import ModuleType
from typing import Any

MOVED = {
    "cli.checks": ("runs.checks",),
    "cli.loading": ("runs.loading",),
    "cli.notebook": ("runs.loading",),
    "cli.resume": ("runs.resume",),
    "cli.store": ("runs.compose",),
    "cli.train": ("runs.train",),
    "cli.training": ("runs.train", "runs.build"),
    "evaluation.learning": ("evaluation.metrics",),
    "evaluation.names": ("evaluation.runs",),
    "evaluation.statistics": ("statistics",),
    "evaluation.tables": ("reports",),
    "evaluation.transcripts": ("evaluation.rollouts",),
    "evaluation.while_training": ("evaluation.rollouts",),
    "markdown": ("reports",),
    "run": ("runs.train",),
    "shipped": ("runs.shipped",),
    "sqlite": ("extras",),
}
"""Old module -> the modules that have its names now, all within the package."""


class _Moved(ModuleType):
    """Stands for a module that is gone, and imports what is asked for from its new place."""

    def __getattr__(self, name: str) -> Any:
        package, _, old = self.__name__.partition(".")
        for new in () if name.startswith("__") else MOVED[old]:
            module = importlib.import_module(f"{package}.{new}")
            if hasattr(module, name):
                warnings.warn(
                    f"{self.__name__}.{name} has moved to {module.__name__}.{name}",
                    DeprecationWarning,
                    stacklevel=2,
                )
                return getattr(module, name)
        raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")


def register(package: str) -> None:
    """Makes the old paths of a package importable; nothing is imported by this."""
    for old in MOVED:
        name = f"{package}.{old}"
        sys.modules.setdefault(name, _Moved(name))
