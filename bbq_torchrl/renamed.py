"""Old names of modules, kept for one version: they import the new ones, with a warning."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import warnings
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import CodeType, ModuleType

RENAMED = {
    "bbq_torchrl.language": "bbq_torchrl.people.language",
    "bbq_torchrl.language.english": "bbq_torchrl.people.language.words",
    "bbq_torchrl.language.frames": "bbq_torchrl.people.language.asking",
    "bbq_torchrl.language.numbers": "bbq_torchrl.people.language.words",
    "bbq_torchrl.language.kept": "bbq_torchrl.people.language.cache",
    "bbq_torchrl.chat": "bbq_torchrl.people.chat",
    "bbq_torchrl.chat.tracking": "bbq_torchrl.people.dialogue.tracker",
    "bbq_torchrl.chat.agent": "bbq_torchrl.people.dialogue.agent",
    "bbq_torchrl.chat.goals": "bbq_torchrl.people.dialogue.judge",
    "bbq_torchrl.chat.partner": "bbq_torchrl.people.dialogue.partner",
    "bbq_torchrl.chat.posterior": "bbq_torchrl.people.dialogue.posterior",
    "bbq_torchrl.chat.simulated_user": "bbq_torchrl.people.study.users",
    "bbq_torchrl.chat.spelling": "bbq_torchrl.people.dialogue.spelling",
    "bbq_torchrl.chat.talker": "bbq_torchrl.people.study.agents",
    "bbq_torchrl.study": "bbq_torchrl.people.study",
    "bbq_torchrl.study.outcome": "bbq_torchrl.people.dialogue.judge",
    "bbq_torchrl.study.rating": "bbq_torchrl.people.study.simulate",
    "bbq_torchrl.study.figures": "bbq_torchrl.people.study.report",
    "bbq_torchrl.study.talk": "bbq_torchrl.people.dialogue.talk",
}
"""Old name -> new name; modules of a renamed package follow it unless they are listed."""


class _Renamed(MetaPathFinder, Loader):
    """Finds modules by their old names. Python asks it last."""

    def __init__(self) -> None:
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        new = _new_name(name)
        found = None if new is None else importlib.util.find_spec(new)
        if found is None:
            return None
        warnings.warn(f"{name} is now {new}", DeprecationWarning, stacklevel=2)
        return ModuleSpec(name, self, is_package=found.submodule_search_locations is not None)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = importlib.import_module(_new_name(spec.name) or "")
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Gives the module its own spec back: it has been executed under its new name."""
        module.__spec__ = self._specs.pop(module.__spec__.name) if module.__spec__ else None

    def get_code(self, name: str) -> CodeType | None:
        """Returns the code of a module that `python -m` runs by its old name."""
        spec = importlib.util.find_spec(_new_name(name) or "")
        code: CodeType | None = spec.loader.get_code(spec.name)  # type: ignore[union-attr]
        return code


def _new_name(name: str) -> str | None:
    head, tail = name, ""
    while head:
        if head in RENAMED:
            return RENAMED[head] + tail
        head, _, last = head.rpartition(".")
        tail = f".{last}{tail}"
    return None


def keep_old_names() -> None:
    """Has Python find modules by their old names, too."""
    if not any(isinstance(finder, _Renamed) for finder in sys.meta_path):
        sys.meta_path.append(_Renamed())
