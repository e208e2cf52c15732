"""Old import paths and commands, which work for one version more."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from bbq_torchrl.renamed import RENAMED


@pytest.mark.parametrize("old", RENAMED)
def test_an_old_name_is_the_new_module_with_a_warning(old):
    for name in [name for name in sys.modules if name.startswith(old)]:
        del sys.modules[name]
    with pytest.warns(DeprecationWarning, match=f"{old} is now {RENAMED[old]}"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(RENAMED[old])
    assert module.__spec__.name == module.__name__ == RENAMED[old]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_unknown_module_of_an_old_package_is_not_found():
    with pytest.raises(ModuleNotFoundError, match=r"bbq_torchrl\.chat\.nowhere"):
        importlib.import_module("bbq_torchrl.chat.nowhere")


@pytest.mark.parametrize("name", ["chat", "language", "study"])
def test_an_old_command_runs(name):
    command = [sys.executable, "-m", f"bbq_torchrl.{name}", "--help"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert text.startswith(f"usage: bbq {name}")
