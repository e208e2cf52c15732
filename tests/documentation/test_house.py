"""The page of the house says what the packages and the import contract are."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from scripts.docs_blocks import house

from .pages import ROOT

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

PAGE = (ROOT / "docs" / "house.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (\d+|–) \| `(\w+)` \| ", PAGE, re.MULTILINE)


def test_every_package_has_a_row() -> None:
    packages = {file.parent.name for file in (ROOT / "bbq_torchrl").glob("*/__init__.py")}
    assert packages <= {room for _, room in ROWS}


def test_the_layers_are_those_of_the_contract() -> None:
    contract = (ROOT / ".importlinter").read_text(encoding="utf-8")
    section = contract.partition("\nlayers =\n")[2].partition("\nignore_imports")[0]
    lines = [re.findall(r"bbq_torchrl\.(\w+)", line) for line in section.splitlines()]
    layers = {room: int(layer) for layer, room in ROWS if layer != "–"}
    expected = {room: len(lines) - row for row, rooms in enumerate(lines) for room in rooms}
    assert {room: layers[room] for room in expected} == expected


def test_the_picture_has_the_rooms_and_arrows_of_today(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = house.FIGURE.read_text(encoding="utf-8")
    monkeypatch.setattr(house, "FIGURE", tmp_path / "house.svg")
    house.draw_house()
    parts = re.compile(r'id="(patch_\d+)"|>(\w+)</text>')  # what another matplotlib draws, too
    drawn = parts.findall(house.FIGURE.read_text(encoding="utf-8"))
    assert len(drawn) > 40
    assert parts.findall(kept) == drawn, "run python scripts/write_docs.py"
