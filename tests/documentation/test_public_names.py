"""The parts' public names are few, and each stands on the page of the parts and on an API page."""

from __future__ import annotations

import importlib
import re

import pytest

from .pages import ROOT

PACKAGES = ("bayes", "networks", "exploration")


def _public(package: str) -> set[str]:
    return set(importlib.import_module(f"bbq_torchrl.{package}").__all__)


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_those_of_the_pages(package: str) -> None:
    parts = (ROOT / "docs" / "parts.md").read_text(encoding="utf-8")
    table = parts.partition(f"| `bbq_torchrl.{package}` |")[2].partition("\n\n")[0]
    listed = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| ([^|]*) \|", table, re.MULTILINE)))
    api = (ROOT / "docs" / "api" / f"{package}.md").read_text(encoding="utf-8")
    shown = re.findall(rf"^::: bbq_torchrl\.{package}\.(\w+)$", api, re.MULTILINE)
    assert sorted(listed) == sorted(shown) == sorted(_public(package))


def test_public_names_are_about_25() -> None:
    assert sum(len(_public(package)) for package in PACKAGES) <= 25


def test_the_example_package_uses_public_names_only() -> None:
    for file in (ROOT / "examples" / "extending").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        for package, names in re.findall(r"from bbq_torchrl\.(\w+) import ([\w, ]+)", text):
            if package in PACKAGES:
                assert {name.strip() for name in names.split(",")} <= _public(package), file.name
        deeper = re.findall(rf"from bbq_torchrl\.((?:{'|'.join(PACKAGES)})\.\w+)", text)
        assert deeper == [], file.name
