"""What the import contracts cannot say: what an import really loads, and torch.nn in domains."""

from __future__ import annotations

import ast
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from .pages import ROOT

if TYPE_CHECKING:
    from pathlib import Path

# Imports what is named, and says which libraries the project's own modules asked for meanwhile.
WATCHED = """
import builtins, sys
asked, real = set(), builtins.__import__
def watch(name, globals=None, locals=None, fromlist=(), level=0):
    if level == 0 and str((globals or {}).get("__name__")).startswith("bbq_torchrl."):
        asked.add(name.partition(".")[0])
    return real(name, globals, locals, fromlist, level)
builtins.__import__ = watch
for name in sys.argv[1:]:
    real(name)
print(*sorted(asked - sys.stdlib_module_names - {"bbq_torchrl"}))
sys.exit("bbq_torchrl.domains" in sys.modules)
"""

DOMAINS = sorted((ROOT / "bbq_torchrl" / "domains").rglob("*.py"))


@pytest.mark.parametrize(
    ("packages", "forbidden"),
    [
        (["options"], "torch"),
        (["domains", "simulator"], "torchrl"),
    ],
)
def test_import_does_not_load(packages: list[str], forbidden: str) -> None:
    names = ", ".join(f"bbq_torchrl.{package}" for package in packages)
    program = f"import sys, {names}; sys.exit({forbidden!r} in sys.modules)"
    finished = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=False)
    assert finished.returncode == 0


def test_the_parts_need_torch_tensordict_torchrl_and_numpy_and_no_dialogue() -> None:
    parts = ["bayes", "networks", "exploration", "objectives", "data", "vime"]
    command = [sys.executable, "-c", WATCHED, *(f"bbq_torchrl.{part}" for part in parts)]
    finished = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    assert finished.stdout.split() == ["numpy", "tensordict", "torch", "torchrl"]


@pytest.mark.parametrize("file", DOMAINS, ids=lambda file: file.stem)
def test_domains_have_no_neural_network(file: Path) -> None:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Attribute):
            names = [ast.unparse(node)]
        assert not [name for name in names if f"{name}.".startswith("torch.nn.")]
