"""Old import paths, which work for one version with a DeprecationWarning."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from types import ModuleType
from typing import Any

_PAGES = {
    "agent": ("bbqn", "bootstrap", "dqn"),
    "domain": ("folder", "miulab", "movie"),
    "env": ("domain_ext", "full"),
    "explore": (
        *("boltzmann", "bootstrap", "epsilon_greedy", "greedy", "noisy"),
        *("thompson", "thompson_boltzmann", "thompson_epsilon"),
    ),
    "intrinsic": ("none", "vime"),
    "logger": ("csv", "mlflow", "tensorboard", "wandb"),
    "protocol": ("paper", "quick"),
    "spike": ("none", "rule"),
}

RENAMED = {
    **{f"options.{page}.{name}": f"options.{page}" for page in _PAGES for name in _PAGES[page]},
    **dict.fromkeys(
        ("hooks", "data.hooks", "exploration.hooks", "objectives.hooks", "trainers.hooks"),
        "protocols",
    ),
    **{f"cli.{name}": f"runs.{name}" for name in ("checks", "loading", "resume", "train")},
    "cli.notebook": "runs.loading",
    "cli.store": "runs.compose",
    "cli.training": "runs.train",
    "evaluation.learning": "evaluation.metrics",
    "evaluation.names": "evaluation.runs",
    "evaluation.statistics": "statistics",
    "evaluation.tables": "reports",
    "evaluation.transcripts": "evaluation.rollouts",
    "evaluation.while_training": "evaluation.rollouts",
    "markdown": "reports",
    "run": "runs.train",
    "shipped": "runs.shipped",
    "sqlite": "extras",
    "bayes.settings": "bayes.replicas",
    "data.validation": "data.rows",
    "domains.validate": "domains.parts",
    "envs.checks": "envs.turns",
    "envs.compiled": "envs.turns",
    "exploration.greedy": "exploration.evaluation",
    "exploration.noisy": "exploration.thompson",
    "objectives.num_data": "objectives.rows",
    "options.base": "options.registry",
    "simulator.bits": "simulator.choices",
    "trainers.memory": "trainers.learn",
    "vime.running_median": "vime.information_gain",
}
"""Old name of a module -> its new one, both within the package."""


class _Renamed(ModuleType):
    """A module that hands over the names of another one, with a warning."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        warnings.warn(f"{self.__name__} is now {self.__doc__}", DeprecationWarning, stacklevel=2)
        return getattr(import_module(str(self.__doc__)), name)


def install(package: str) -> None:
    """Makes the old paths of a package importable; nothing is imported before they are used."""
    for old, new in RENAMED.items():
        sys.modules[f"{package}.{old}"] = _Renamed(f"{package}.{old}", f"{package}.{new}")
