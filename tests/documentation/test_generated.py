"""The tables in the documentation are those that the code and the results give."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import pytest

from bbq_torchrl.options import Config, EvaluateConfig, schemas
from scripts import write_docs

from .pages import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterable

CONFIGURATION = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")


def test_no_page_is_out_of_date() -> None:
    pages = [page.name for page in write_docs.outdated(write_docs.BLOCKS)]
    assert pages == [], "run python scripts/write_docs.py"


def test_every_block_is_on_a_page() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in write_docs.pages())
    missing = [name for name in write_docs.BLOCKS if f"<!-- begin: {name} -->" not in text]
    assert missing == []


@pytest.mark.parametrize(
    ("prefix", "options"),
    [
        ("", [Config, EvaluateConfig]),
        *((f"{group}.", found.values()) for group, found in schemas().items()),
    ],
)
def test_every_key_is_documented(prefix: str, options: Iterable[type]) -> None:
    keys = {item.name for option in options for item in fields(option)} - {"name", *schemas()}
    assert [key for key in keys if f"| `{prefix}{key}` |" not in CONFIGURATION] == []


def test_block_is_replaced_and_the_rest_is_kept() -> None:
    page = "before\n<!-- begin: a -->\nold\n<!-- end: a -->\nafter\n"
    filled = write_docs.rewrite(page, {"a": lambda: "new"})
    assert filled == "before\n<!-- begin: a -->\n\nnew\n\n<!-- end: a -->\nafter\n"
    assert write_docs.rewrite(filled, {"a": lambda: "new"}) == filled


def test_unknown_block_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown block 'b'; known are \\['a'\\]"):
        write_docs.rewrite("<!-- begin: b -->\n<!-- end: b -->", {"a": lambda: "new"})


def test_block_that_is_not_closed_is_refused() -> None:
    with pytest.raises(ValueError, match="not closed"):
        write_docs.rewrite("<!-- begin: a -->\nold\n<!-- end: b -->", {"a": lambda: "new"})
