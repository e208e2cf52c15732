"""What CONTRIBUTING.md and README.md name is there: paths, tools, stages, the two commands."""

from __future__ import annotations

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


@pytest.mark.parametrize("ending", [r"train\.py", "pytest"])
def test_ci_finds_the_readmes_one_line_commands(ending: str) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(re.findall(rf"^python3 -m venv \.venv && .*{ending}", text, re.MULTILINE)) == 1
