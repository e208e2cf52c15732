"""The site works from the file system, and its pages are all reachable."""

from __future__ import annotations

import re
from types import SimpleNamespace

import pytest

from scripts import mkdocs_hooks

from .pages import ROOT

CONFIGURATION = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")


def test_search_needs_no_server_and_no_network() -> None:
    assert "\nuse_directory_urls: false\n" in CONFIGURATION
    assert "\n  - offline\n" in CONFIGURATION
    [script] = re.findall(r"polyfills:\n +- (\S*iframe-worker\S*)\n", CONFIGURATION)
    assert "window.Worker=" in (ROOT / "docs" / script).read_text(encoding="utf-8")


def test_every_page_is_in_the_navigation() -> None:
    pages = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")}
    assert pages == set(re.findall(r": ([\w/]+\.md)$", CONFIGURATION, re.MULTILINE))


@pytest.mark.parametrize("page", ["contributing.md", "changelog.md"])
def test_files_of_the_root_are_pages_with_links_that_hold(page: str) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    shown = mkdocs_hooks.on_page_markdown(text, page=SimpleNamespace())
    assert "\n## " in shown
    for link in re.findall(r"\]\(([\w/]+\.\w+)[)#]", shown):
        assert (ROOT / "docs" / link).is_file(), link
