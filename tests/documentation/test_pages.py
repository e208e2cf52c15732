"""Pages agree with the repository and the configuration; generated parts are current."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import pytest

from bbq_torchrl.options import Config, EvaluateConfig, schemas
from scripts import mkdocs_hooks, write_docs

from .pages import ROOT, snippets

DOCS = ROOT / "docs"


def text_of(*names: str) -> str:
    return ROOT.joinpath(*names).read_text(encoding="utf-8")


CONTRIBUTING = text_of("CONTRIBUTING.md")
CODE = [
    *re.findall(r"`([^`\n]+)`", CONTRIBUTING),
    *(line for text in snippets(ROOT / "CONTRIBUTING.md", "bash") for line in text.splitlines()),
]
FILE = re.compile(r"^\.?[\w.-]+/[\w./-]*$|^[\w-]+\.(?:md|py|yaml|toml)$|^\.importlinter$")


def test_files_that_contributing_names_exist():
    words = [word for text in CODE for word in text.split()]
    links = re.findall(r"\]\(([\w./-]+)\)", CONTRIBUTING)
    paths = {word for word in [*words, *links] if FILE.match(word)}
    assert {"scripts/check", "tests/adversary/", "CHANGELOG.md", "docs/house.md"} <= paths
    # Beside the repository, made by a command, or of the environment.
    paths = {path for path in paths if not path.startswith(("../", ".venv/"))}
    found = {path for path in paths if (ROOT / path).exists() or any((ROOT / "tests").rglob(path))}
    assert found == paths


def test_programs_that_contributing_names_exist():
    lines = [re.sub(r"^(\w+=\S+ )+", "", text) for text in CODE]
    programs = {
        line.split()[0] for line in lines if line.startswith((".venv/", "scripts/", ".ci/"))
    }
    assert ".ci/run" in programs
    for program in programs:
        if program.startswith(".venv/bin/"):
            assert shutil.which(Path(program).name, path=sysconfig.get_path("scripts")), program
        else:
            assert (ROOT / program).stat().st_mode & 0o111, program


def test_stages_of_the_check_exist():
    stages = set(re.findall(r"^    (\w+)\) ", text_of("scripts", "check"), re.MULTILINE))
    named = [shlex.split(text, comments=True) for text in CODE if text.startswith("scripts/check ")]
    words = {word for arguments in named for word in arguments[1:]}
    assert words
    assert words <= stages


def docstrings(file):
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return [ast.get_docstring(node) or "" for node in nodes if isinstance(node, kinds)]


def in_another_dialect(docstring):
    """The arguments and attributes with a type, and the defaults told otherwise."""
    sections = re.findall(r"^(?:\w+ )?(?:Args|Attributes):\n((?:    .*\n?|\n)*)", docstring, re.M)
    typed = [name for text in sections for name in re.findall(r"^    ([\w*]+ \(.*\):)", text, re.M)]
    return typed + re.findall(r"\bDefault: .*", docstring)


def test_docstrings_leave_types_to_the_signature_and_tell_defaults_one_way():
    other = "Do.\n\nKeyword Args:\n    *a (tuple of int, optional): of\n        it. Default: 1."
    assert in_another_dialect(other) == ["*a (tuple of int, optional):", "Default: 1."]
    assert in_another_dialect("Do.\n\nArgs:\n    a: as in f(x): it (or b). Defaults to 1.") == []
    found = [
        f"{file.relative_to(ROOT)}: {words}"
        for file in sorted((ROOT / "bbq_torchrl").rglob("*.py"))
        for docstring in docstrings(file)
        for words in in_another_dialect(docstring)
    ]
    assert found == []


@pytest.mark.parametrize("ending", [r"train\.py", "pytest"])
def test_ci_finds_the_readmes_one_line_commands(ending):
    commands = rf"^python3 -m venv \.venv && .*{ending}"
    assert len(re.findall(commands, text_of("README.md"), re.MULTILINE)) == 1


def test_no_page_is_out_of_date():
    pages = [page.name for page in write_docs.outdated(write_docs.BLOCKS)]
    assert pages == [], "run python scripts/write_docs.py"


def test_every_block_is_on_a_page():
    text = "".join(page.read_text(encoding="utf-8") for page in write_docs.pages())
    missing = [name for name in write_docs.BLOCKS if f"<!-- begin: {name} -->" not in text]
    assert missing == []


def test_a_block_is_replaced_and_the_rest_is_kept():
    page = "before\n<!-- begin: a -->\nold\n<!-- end: a -->\nafter\n"
    filled = write_docs.rewrite(page, {"a": lambda: "new"})
    assert filled == "before\n<!-- begin: a -->\n\nnew\n\n<!-- end: a -->\nafter\n"
    assert write_docs.rewrite(filled, {"a": lambda: "new"}) == filled


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ("<!-- begin: b -->\n<!-- end: b -->", r"unknown block 'b'; known are \['a'\]"),
        ("<!-- begin: a -->\nold\n<!-- end: b -->", "not closed"),
    ],
)
def test_a_block_that_is_unknown_or_not_closed_is_refused(page, message):
    with pytest.raises(ValueError, match=message):
        write_docs.rewrite(page, {"a": lambda: "new"})


@pytest.mark.parametrize(
    ("prefix", "options"),
    [
        ("", [Config, EvaluateConfig]),
        *((f"{group}.", found.values()) for group, found in schemas().items()),
    ],
)
def test_every_key_is_documented(prefix, options):
    page = text_of("docs", "configuration.md")
    keys = {item.name for option in options for item in fields(option)} - {"name", *schemas()}
    assert [key for key in keys if f"| `{prefix}{key}` |" not in page] == []


@pytest.mark.parametrize(("link", "code"), [("index.md", 0), ("missing.md", 1), ("index.md#a", 1)])
def test_the_check_of_the_documentation_fails_where_a_link_leads_nowhere(link, code, tmp_path):
    [stage] = re.findall(
        r"^    docs\) (mkdocs build .*) --site-dir", text_of("scripts", "check"), re.M
    )
    validation = text_of("mkdocs.yml").partition("\nvalidation:\n")[2].partition("\n\n")[0]
    (tmp_path / "mkdocs.yml").write_text(f"site_name: a\nvalidation:\n{validation}\n")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(f"[a page]({link})\n")

    done = subprocess.run(
        [sys.executable, "-m", *stage.split(), "--site-dir", tmp_path / "site"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )

    assert done.returncode == code, done.stdout + done.stderr


def test_search_on_the_site_needs_no_server_and_no_network():
    configuration = text_of("mkdocs.yml")
    assert "\nuse_directory_urls: false\n" in configuration
    assert "\n  - offline\n" in configuration
    [script] = re.findall(r"polyfills:\n +- (\S*iframe-worker\S*)\n", configuration)
    assert "window.Worker=" in text_of("docs", script)


def test_every_page_is_in_the_navigation():
    pages = {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}
    assert pages == set(re.findall(r": ([\w/]+\.md)$", text_of("mkdocs.yml"), re.MULTILINE))


@pytest.mark.parametrize("page", ["contributing.md", "changelog.md"])
def test_files_of_the_root_are_pages_with_links_that_hold(page):
    shown = mkdocs_hooks.on_page_markdown(text_of("docs", page), page=SimpleNamespace())
    assert "\n## " in shown
    for link in re.findall(r"\]\(([\w/]+\.\w+)[)#]", shown):
        assert (DOCS / link).is_file(), link
