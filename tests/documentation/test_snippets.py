"""The Python in the documentation runs, and the command lines in it are accepted."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING

import pytest

from bbq_torchrl.cli.store import compose
from bbq_torchrl.options import EvaluateConfig, registry
from bbq_torchrl.options.registry import conf_folder
from bbq_torchrl.search.definition import compose_search

from .pages import PAGES, commands, snippets

if TYPE_CHECKING:
    from pathlib import Path

WITH_PYTHON = [page for page in PAGES if snippets(page, "python")]


def test_readme_and_parts_page_show_python() -> None:
    assert {"README.md", "parts.md"} <= {page.name for page in WITH_PYTHON}


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.name)
def test_python_of_a_page_runs_from_top_to_bottom(
    page: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = {group: dict(found) for group, found in registry.schemas().items()}
    monkeypatch.setattr(registry, "_OPTIONS", known)  # a page's options are its own
    module = ModuleType(page.stem)
    monkeypatch.setitem(sys.modules, page.stem, module)
    for text in snippets(page, "python"):
        exec(compile(text, str(page), "exec"), vars(module))


def _arguments(arguments: list[str], folder: Path) -> list[str]:
    """Returns a documented command's overrides with a real folder in the place of <folder>."""
    given = [argument.replace("<folder>", str(folder)) for argument in arguments]
    return [argument for argument in given if not argument.startswith("--")]


def _is_composed(arguments: list[str]) -> bool:
    """Whether a command stands for a configuration by itself: no help, no resumed run."""
    shows_help = bool({"--help", "--cfg"} & set(arguments))
    return not shows_help and not any(item.startswith("resume=") for item in arguments)


def _telling(found: list[tuple[str, list[str]]], *alike: str) -> list[tuple[str, list[str]]]:
    """Returns the commands with a word that none before has; any value will do for some keys."""
    known: set[str] = set()
    kept = []
    for page, arguments in found:
        words = {item for item in arguments if item.partition("=")[0] not in alike}
        if words - known:
            kept.append((page, arguments))
            known |= words
    return kept


TRAININGS = [item for item in commands("train.py") if _is_composed(item[1])]
EVALUATIONS = commands("-m bbq_torchrl.evaluate")


@pytest.mark.parametrize(
    ("page", "arguments"), _telling(TRAININGS, "seed", "replicas", "threads", "hydra.run.dir")
)
def test_documented_training_is_accepted(page: str, arguments: list[str], tmp_path: Path) -> None:
    overrides = _arguments(arguments, tmp_path)
    if "--multirun" in arguments:
        # Of every list of a sweep the first element stands for all.
        overrides = [_first(argument) for argument in overrides]
    compose([item for item in overrides if not item.startswith("hydra")])


def _first(argument: str) -> str:
    key, _, value = argument.partition("=")
    if value.startswith("range("):
        return f"{key}=0"
    if value == "glob(*)":
        files = (conf_folder() / key.removeprefix("+")).glob("*.yaml")
        return f"{key}={min(file.stem for file in files)}"
    return f"{key}={value.split(',')[0]}"


@pytest.mark.parametrize(
    ("page", "arguments"), _telling(EVALUATIONS, "policy", "dialogues", "batch", "log")
)
def test_documented_evaluation_is_accepted(page: str, arguments: list[str], tmp_path: Path) -> None:
    compose(_arguments(arguments, tmp_path), EvaluateConfig)


@pytest.mark.parametrize(("page", "arguments"), _telling(commands("-m bbq_torchrl.search")))
def test_documented_search_is_accepted(page: str, arguments: list[str], tmp_path: Path) -> None:
    compose_search([item for item in _arguments(arguments, tmp_path) if item != "&"])


def test_documentation_shows_training_and_evaluation() -> None:
    assert len(TRAININGS) >= 10
    assert len(EVALUATIONS) >= 3
