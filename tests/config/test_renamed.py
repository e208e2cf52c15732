"""Old import paths and commands, which work for one more version."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from bbq_torchrl.renamed import MODULES, PACKAGES


@pytest.mark.parametrize("old", MODULES)
def test_an_old_module_has_the_names_of_the_new_ones_and_warns(old):
    for new in MODULES[old]:
        module = importlib.import_module(f"bbq_torchrl.{new}")
        name = next(
            name
            for name, value in vars(module).items()
            if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
        )
        with pytest.warns(DeprecationWarning, match=f"bbq_torchrl.{old} is now {module.__name__}"):
            found = getattr(importlib.import_module(f"bbq_torchrl.{old}"), name)
        assert found is getattr(module, name)


def test_an_old_module_lacks_what_the_new_one_lacks():
    with pytest.raises(ImportError, match="cannot import name 'Unknown'"):
        from bbq_torchrl.options.agent.dqn import Unknown  # noqa: F401


@pytest.mark.parametrize("old", PACKAGES)
def test_an_old_package_is_the_new_one_with_a_warning(old):
    old, new = f"bbq_torchrl.{old}", f"bbq_torchrl.{PACKAGES[old]}"
    for name in [name for name in sys.modules if name.startswith(old)]:
        del sys.modules[name]
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(new)
    assert module.__spec__.name == module.__name__ == new


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_unknown_module_of_an_old_package_is_not_found():
    with pytest.raises(ModuleNotFoundError, match=r"bbq_torchrl\.chat\.nowhere"):
        importlib.import_module("bbq_torchrl.chat.nowhere")


@pytest.mark.parametrize("name", ["chat", "language", "study"])
def test_an_old_command_runs(name):
    command = [sys.executable, "-m", f"bbq_torchrl.{name}", "--help"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert text.startswith(f"usage: bbq {name}")
