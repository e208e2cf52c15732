"""Old import paths, which work for one version with a DeprecationWarning."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import warnings
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import CodeType

PACKAGES = {
    "evaluate": "cli.evaluate",
    "chat": "people.chat",
    "chat.agent": "people.dialogue.agent",
    "chat.goals": "people.dialogue.judge",
    "chat.partner": "people.dialogue.partner",
    "chat.posterior": "people.dialogue.agent",
    "chat.simulated_user": "people.study.users",
    "chat.spelling": "people.dialogue.spelling",
    "chat.talker": "people.study.agents",
    "chat.tracking": "people.dialogue.tracker",
    "language": "people.language",
    "language.english": "people.language.words",
    "language.frames": "people.language.asking",
    "language.kept": "people.language.cache",
    "language.numbers": "people.language.words",
    "study": "people.study",
    "study.figures": "people.study.report",
    "study.outcome": "people.dialogue.judge",
    "study.rating": "people.study.simulate",
    "study.talk": "people.dialogue",
}
"""Old package or command -> new one; modules not listed here keep their names in it."""

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

_UTILS = ("extras", "interruption", "output", "reports", "seeds", "statistics", "text")

MODULES = {
    **{f"options.{page}.{name}": (f"options.{page}",) for page in _PAGES for name in _PAGES[page]},
    **dict.fromkeys(
        ("hooks", "data.hooks", "exploration.hooks", "objectives.hooks", "trainers.hooks"),
        ("protocols",),
    ),
    **{f"cli.{name}": (f"runs.{name}",) for name in ("checks", "loading", "resume", "train")},
    **{name: (f"utils.{name}",) for name in _UTILS},
    **dict.fromkeys(("plain_yaml", "run_folder"), ("utils.files",)),
    "pages": ("utils.output",),
    "calibrate": ("cli.calibrate",),
    "cli.notebook": ("runs.loading",),
    "cli.store": ("runs.compose",),
    "cli.training": ("runs.train", "runs.build"),
    "evaluation.learning": ("evaluation.metrics",),
    "evaluation.names": ("evaluation.runs",),
    "evaluation.statistics": ("utils.statistics",),
    "evaluation.tables": ("utils.reports",),
    "evaluation.transcripts": ("evaluation.rollouts",),
    "evaluation.while_training": ("evaluation.rollouts",),
    "markdown": ("utils.reports",),
    "run": ("runs.train",),
    "shipped": ("runs.shipped",),
    "sqlite": ("utils.extras",),
    "bayes.bayes_conv": ("bayes.layers",),
    "bayes.linear_regression": ("objectives.gaussian_process",),
    "bayes.settings": ("bayes.replicas",),
    "data.count_reward": ("data.bonus_reward",),
    "data.validation": ("data.rows",),
    "domains.coding": ("domains.frames",),
    "domains.specification": ("domains.files",),
    "domains.spelling": ("domains.values",),
    "domains.tables": ("domains.files",),
    "domains.validate": ("domains.parts",),
    "envs.checks": ("envs.parts",),
    "envs.clairvoyant": ("envs.policies",),
    "envs.compiled": ("envs.parts",),
    "envs.schedule": ("envs.parts",),
    "envs.state": ("envs.parts",),
    "envs.turns": ("envs.parts",),
    "evaluation.ablations": ("evaluation.designs",),
    "evaluation.grid": ("evaluation.designs",),
    "exploration.boltzmann": ("exploration.annealed",),
    "exploration.egreedy": ("exploration.annealed",),
    "exploration.greedy": ("exploration.evaluation",),
    "exploration.noisy": ("exploration.thompson",),
    "networks.bootstrap_mlp": ("networks.mlp",),
    "networks.flat_mlp": ("networks.mlp",),
    "objectives.bootstrap": ("objectives.dqn",),
    "objectives.margin": ("objectives.td_loss",),
    "objectives.num_data": ("objectives.rows",),
    "options.agreements": ("options.root",),
    "options.base": ("options.registry",),
    "options.values": ("options.task",),
    "people.dialogue.acting": ("people.dialogue.tracker",),
    "people.dialogue.posterior": ("people.dialogue.agent",),
    "people.dialogue.talk": ("people.dialogue",),
    "people.language.intents": ("people.language.learners",),
    "people.language.noise": ("people.language.surfaces",),
    "people.language.strange": ("people.language.labeled",),
    "people.language.tagger": ("people.language.learners",),
    "people.study.export": ("people.study.keeping",),
    "people.study.power": ("people.study.comparisons",),
    "people.typed": ("utils.text",),
    "simulator.bits": ("simulator.choices",),
    "simulator.mixed_user": ("simulator.user",),
    "simulator.rewards": ("simulator.features",),
    "trainers.memory": ("trainers.learn",),
    "trainers.progress": ("trainers.metrics",),
    "trainers.spiking": ("trainers.collect",),
    "vime.running_median": ("vime.information_gain",),
}
"""Old module -> the modules that now have its names."""


class _Stand(ModuleType):
    """A removed module, which takes its names from the new modules."""

    def __getattr__(self, name: str) -> Any:
        package, _, old = self.__name__.partition(".")
        for new in () if name.startswith("__") else MODULES[old]:
            module = importlib.import_module(f"{package}.{new}")
            if hasattr(module, name):
                _warn(self.__name__, module.__name__)
                return getattr(module, name)
        raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")


class _Finder(MetaPathFinder, Loader):
    """Finds modules by their package's old name, also for `python -m`, after all other finders."""

    def __init__(self, package: str) -> None:
        self._package = package
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        new = self._new_name(name)
        found = None if new is None else importlib.util.find_spec(new)
        if new is None or found is None:
            return None
        _warn(name, new)
        return ModuleSpec(name, self, is_package=found.submodule_search_locations is not None)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(self._new_name(spec.name) or "")
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restores the module's spec: it has been executed under its new name."""
        module.__spec__ = self._specs.pop(module.__spec__.name) if module.__spec__ else None

    def get_code(self, name: str) -> CodeType | None:
        """Returns the code of a module for `python -m` with its old name."""
        spec = importlib.util.find_spec(self._new_name(name) or "")
        code: CodeType | None = spec.loader.get_code(spec.name)  # type: ignore[union-attr]
        return code

    def _new_name(self, name: str) -> str | None:
        package, _, head = name.partition(".")
        tail = ""
        while package == self._package and head:
            if head in PACKAGES:
                return f"{package}.{PACKAGES[head]}{tail}"
            head, _, last = head.rpartition(".")
            tail = f".{last}{tail}"
        return None


def _warn(old: str, new: str) -> None:
    warnings.warn(f"{old} is now {new}", DeprecationWarning, stacklevel=3)


def install(package: str) -> None:
    """Makes the old names of a package importable, without importing anything."""
    for old in MODULES:
        sys.modules.setdefault(f"{package}.{old}", _Stand(f"{package}.{old}"))
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.append(_Finder(package))
