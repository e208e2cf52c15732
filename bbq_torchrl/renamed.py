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
    "chat.agent": "people.dialogue.trained_agent",
    "chat.goals": "people.dialogue.judge",
    "chat.partner": "people.dialogue.partner",
    "chat.posterior": "people.dialogue.trained_agent",
    "chat.simulated_user": "people.study.users",
    "chat.spelling": "people.dialogue.spelling",
    "chat.talker": "people.study.agents",
    "chat.tracking": "people.dialogue.tracking",
    "language": "people.language",
    "language.english": "people.language.words",
    "language.frames": "people.language.asking",
    "language.intents": "people.language.learners",
    "language.kept": "people.language.cache",
    "language.noise": "people.language.paraphrase",
    "language.numbers": "people.language.words",
    "language.strange": "people.language.training_lines",
    "language.tagger": "people.language.learners",
    "study": "people.study",
    "study.export": "people.study.keeping",
    "study.figures": "people.study.report",
    "study.outcome": "people.dialogue.judge",
    "study.power": "people.study.comparisons",
    "study.rating": "people.study.simulate",
    "study.talk": "people.dialogue",
}
"""Old package or command -> new one; modules not listed here keep their names in it."""

_NAMES_OF = {
    "bayes.layers": "bayes.bayes_conv",
    "bayes.replicas": "bayes.settings",
    "cli.calibrate": "calibrate",
    "data.bonus_reward": "data.count_reward",
    "data.rows": "data.validation",
    "domains.files": "domains.tables",
    "domains.frames": "domains.coding",
    "domains.specification": "domains.validate",
    "domains.values": "domains.spelling",
    "envs.extension": "envs.checks envs.compiled envs.schedule envs.state envs.turns",
    "envs.policies": "envs.clairvoyant",
    "evaluation.designs": "evaluation.ablations evaluation.grid",
    "evaluation.metrics": "evaluation.learning",
    "evaluation.rollouts": "evaluation.transcripts evaluation.while_training",
    "evaluation.runs": "evaluation.names",
    "exploration.annealed": "exploration.boltzmann exploration.egreedy",
    "exploration.evaluation": "exploration.greedy",
    "exploration.thompson": "exploration.noisy",
    "networks.mlp": "networks.bootstrap_mlp networks.flat_mlp",
    "objectives.dqn": "objectives.bootstrap",
    "objectives.gaussian_process": "bayes.linear_regression",
    "objectives.rows": "objectives.num_data",
    "objectives.td_loss": "objectives.margin",
    "options.agent": "options.agent.bbqn options.agent.bootstrap options.agent.dqn",
    "options.domain": "options.domain.folder options.domain.miulab options.domain.movie",
    "options.env": "options.env.domain_ext options.env.full",
    "options.explore": (
        "options.explore.boltzmann options.explore.bootstrap options.explore.epsilon_greedy "
        "options.explore.greedy options.explore.noisy options.explore.thompson "
        "options.explore.thompson_boltzmann options.explore.thompson_epsilon"
    ),
    "options.intrinsic": "options.intrinsic.none options.intrinsic.vime",
    "options.logger": (
        "options.logger.csv options.logger.mlflow options.logger.tensorboard options.logger.wandb"
    ),
    "options.protocol": "options.protocol.paper options.protocol.quick",
    "options.registry": "options.base",
    "options.root": "options.agreements",
    "options.spike": "options.spike.none options.spike.rule",
    "options.task": "options.values",
    "protocols": "data.hooks exploration.hooks hooks objectives.hooks trainers.hooks",
    "runs.build": "cli.training",
    "runs.checks": "cli.checks",
    "runs.compose": "cli.store",
    "runs.loading": "cli.loading cli.notebook",
    "runs.resume": "cli.resume",
    "runs.shipped": "shipped",
    "runs.train": "cli.train cli.training run",
    "simulator.choices": "simulator.bits",
    "simulator.features": "simulator.rewards",
    "simulator.user": "simulator.mixed_user",
    "trainers.collect": "trainers.spiking",
    "trainers.learn": "trainers.memory",
    "trainers.metrics": "trainers.progress",
    "utils.extras": "extras sqlite",
    "utils.files": "plain_yaml run_folder",
    "utils.interruption": "interruption",
    "utils.output": "output pages",
    "utils.reports": "evaluation.tables markdown reports",
    "utils.seeds": "seeds",
    "utils.statistics": "evaluation.statistics statistics",
    "utils.text": "text",
    "vime.information_gain": "vime.running_median",
}
"""Module -> the old modules whose names it now has."""

MODULES: dict[str, tuple[str, ...]] = {}
for _new, _olds in _NAMES_OF.items():
    for _old in _olds.split():
        MODULES[_old] = (*MODULES.get(_old, ()), _new)
"""Old module -> the modules that now have its names."""


class _OldModule(ModuleType):
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
        sys.modules.setdefault(f"{package}.{old}", _OldModule(f"{package}.{old}"))
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.append(_Finder(package))
