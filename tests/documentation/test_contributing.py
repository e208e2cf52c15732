"""What CONTRIBUTING.md and README.md name is there, and its way to write a docstring is kept."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import sysconfig
from pathlib import Path

import pytest

from .pages import ROOT, snippets

PAGE = ROOT / "CONTRIBUTING.md"
TEXT = PAGE.read_text(encoding="utf-8")
CODE = [
    *re.findall(r"`([^`\n]+)`", TEXT),
    *(line for text in snippets(PAGE, "bash") for line in text.splitlines()),
]
FILE = re.compile(r"^\.?[\w.-]+/[\w./-]*$|^[\w-]+\.(?:md|py|yaml|toml)$|^\.importlinter$")


def _paths() -> set[str]:
    words = [word for text in CODE for word in text.split()]
    links = re.findall(r"\]\(([\w./-]+)\)", TEXT)
    found = {word for word in [*words, *links] if FILE.match(word)}
    # Beside the repository, made by a command, or of the environment.
    return {word for word in found if not word.startswith(("../", ".venv/"))}


def test_paths_are_found_in_the_text() -> None:
    assert {"scripts/check", "tests/adversary/", "CHANGELOG.md", "docs/house.md"} <= _paths()


@pytest.mark.parametrize("path", sorted(_paths()))
def test_path_exists(path: str) -> None:
    assert (ROOT / path).exists() or any((ROOT / "tests").rglob(path))


def _programs() -> set[str]:
    lines = [re.sub(r"^(\w+=\S+ )+", "", text) for text in CODE]
    return {
        line.split()[0] for line in lines if line.startswith((".venv/bin/", "scripts/", ".ci/"))
    }


@pytest.mark.parametrize("program", sorted(_programs()))
def test_program_exists(program: str) -> None:
    if program.startswith(".venv/bin/"):
        assert shutil.which(Path(program).name, path=sysconfig.get_path("scripts"))
    else:
        assert shutil.which(program, path=str(ROOT)) or (ROOT / program).stat().st_mode & 0o111


def test_stages_of_the_check_exist() -> None:
    script = (ROOT / "scripts" / "check").read_text(encoding="utf-8")
    stages = set(re.findall(r"^    (\w+)\) ", script, re.MULTILINE))
    named = [
        shlex.split(text, comments=True)[1:] for text in CODE if text.startswith("scripts/check ")
    ]
    words = {word for arguments in named for word in arguments}
    assert words
    assert words <= stages


def _docstrings(file: Path) -> list[str]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return [ast.get_docstring(node) or "" for node in nodes if isinstance(node, kinds)]


def _in_another_dialect(docstring: str) -> list[str]:
    """Returns the arguments and attributes with a type, and the defaults told otherwise."""
    sections = re.findall(r"^(?:\w+ )?(?:Args|Attributes):\n((?:    .*\n?|\n)*)", docstring, re.M)
    typed = [name for text in sections for name in re.findall(r"^    ([\w*]+ \(.*\):)", text, re.M)]
    return typed + re.findall(r"\bDefault: .*", docstring)


def test_another_dialect_of_docstrings_is_seen() -> None:
    other = "Do.\n\nKeyword Args:\n    *a (tuple of int, optional): of\n        it. Default: 1."
    assert _in_another_dialect(other) == ["*a (tuple of int, optional):", "Default: 1."]
    assert _in_another_dialect("Do.\n\nArgs:\n    a: as in f(x): it (or b). Defaults to 1.") == []


def test_docstrings_leave_types_to_the_signature_and_tell_defaults_one_way() -> None:
    found = [
        f"{file.relative_to(ROOT)}: {words}"
        for file in sorted((ROOT / "bbq_torchrl").rglob("*.py"))
        for docstring in _docstrings(file)
        for words in _in_another_dialect(docstring)
    ]
    assert found == []


@pytest.mark.parametrize("ending", [r"train\.py", "pytest"])
def test_ci_finds_the_readmes_one_line_commands(ending: str) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(re.findall(rf"^python3 -m venv \.venv && .*{ending}", text, re.MULTILINE)) == 1
