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

DOMAINS = sorted((ROOT / "bbq_torchrl" / "domains").rglob("*.py"))


@pytest.mark.parametrize(
    ("packages", "forbidden"),
    [
        (["options"], "torch"),
        (["domains", "simulator"], "torchrl"),
        (["bayes", "networks", "exploration", "objectives", "data", "vime"], "bbq_torchrl.domains"),
    ],
)
def test_import_does_not_load(packages: list[str], forbidden: str) -> None:
    names = ", ".join(f"bbq_torchrl.{package}" for package in packages)
    program = f"import sys, {names}; sys.exit({forbidden!r} in sys.modules)"
    finished = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=False)
    assert finished.returncode == 0


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
