"""What the import contracts cannot say: what an import really loads, and torch.nn in domains."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

import forked
import pytest

from .pages import ROOT

if TYPE_CHECKING:
    from pathlib import Path

# One process, since importing torch and torchrl takes seconds: what loads little comes first. The
# parts are imported anew, and watched: which libraries do the project's own modules ask for?
PROGRAM = """
import builtins, sys
import bbq_torchrl.options
bbq_torchrl.options.schemas()
assert "torch" not in sys.modules, "options load torch"
import bbq_torchrl.domains, bbq_torchrl.simulator
assert "torchrl" not in sys.modules, "domains or simulator load torchrl"
for name in [name for name in sys.modules if name.startswith("bbq_torchrl")]:
    del sys.modules[name]
asked, real = set(), builtins.__import__
def watch(name, globals=None, locals=None, fromlist=(), level=0):
    if level == 0 and str((globals or {}).get("__name__")).startswith("bbq_torchrl."):
        asked.add(name.partition(".")[0])
    return real(name, globals, locals, fromlist, level)
builtins.__import__ = watch
for name in ("bayes", "networks", "exploration", "objectives", "data", "vime"):
    real(f"bbq_torchrl.{name}")
assert "bbq_torchrl.domains" not in sys.modules, "the parts load domains"
print(*sorted(asked - sys.stdlib_module_names - {"bbq_torchrl"}))
"""

DOMAINS = sorted((ROOT / "bbq_torchrl" / "domains").rglob("*.py"))


def test_options_need_no_torch_dialogues_no_torchrl_and_the_parts_no_dialogue() -> None:
    asked, _ = forked.python("-c", PROGRAM, cwd=ROOT)
    assert asked.split() == ["numpy", "tensordict", "torch", "torchrl"]


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
