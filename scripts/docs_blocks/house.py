"""The rooms of the package, their layers and arrows: the table and the picture of docs/house.md."""

from __future__ import annotations

import ast
import re
from configparser import ConfigParser
from functools import cache
from typing import TYPE_CHECKING

import grimp
import networkx

from scripts.docs_blocks.common import FIGURES, ROOT, block, code, table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["FIGURE", "draw_house", "picture"]

PACKAGE = "bbq_torchrl"
FIGURE = FIGURES / "house.svg"

_BAND, _BOX, _WIDTH = 62, (104, 34), 760  # pixels
_ALONE = (0.22, 0.5, 0.78)  # where a room that is alone in its layer stands, so that arrows pass


@cache
def _layers() -> tuple[list[list[str]], int, list[str]]:
    """Returns the rooms of each layer, the highest first, how many layers, and ignored imports.

    Packages that the contract of the layers does not name stand above all others.
    """
    parser = ConfigParser()
    parser.read(ROOT / ".importlinter", encoding="utf-8")
    contract = parser["importlinter:contract:layers"]
    lines = contract["layers"].replace(f"{PACKAGE}.", "").strip().split("\n")
    named = [[name.strip() for name in re.split("[|:]", line)] for line in lines]
    packages = {file.parent.name for file in (ROOT / PACKAGE).glob("*/__init__.py")}
    others = sorted(packages.difference(*named))
    passed = contract["ignore_imports"].strip().split("\n")
    return [others, *named] if others else named, len(named), passed


@cache
def _arrows() -> Mapping[str, frozenset[str]]:
    """Returns which rooms each room imports, but for the imports that the contract lets pass."""
    graph = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True, cache_dir=None)
    layers, _, passed = _layers()
    for importer, imported in (line.split(" -> ") for line in passed):
        graph.remove_import(importer=importer, imported=imported)
    known = {f"{PACKAGE}.{room}": room for layer in layers for room in layer}
    for module in known:
        graph.squash_module(module)
    return {
        room: frozenset(
            known[other]
            for other in graph.find_modules_directly_imported_by(module) & known.keys() - {module}
        )
        for module, room in known.items()
    }


def _holds(room: str) -> str:
    """Returns the first sentence that a room says of itself."""
    folder = ROOT / PACKAGE
    file = folder / room / "__init__.py" if (folder / room).is_dir() else folder / f"{room}.py"
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.partition("\n\n")[0].replace("\n", " ").replace("``", "`").rstrip(".")


@block("house.rooms")
def _table() -> str:
    """Returns a row for each room, from the highest layer to the lowest, which is 1."""
    layers, count, _ = _layers()
    order = [room for layer in layers for room in layer]
    rows = [
        (
            height if height <= count else "–",
            code(room),
            _holds(room),
            ", ".join(sorted(_arrows()[room], key=order.index)) or "–",
        )
        for height, layer in zip(range(len(layers), 0, -1), layers, strict=True)
        for room in layer
    ]
    return table(("layer", "room", "holds", "imports"), rows)


def _shown_arrows() -> list[tuple[str, str]]:
    """Returns the arrows that go down and do not follow from two others, sorted."""
    height = {room: -row for row, layer in enumerate(_layers()[0]) for room in layer}
    down = networkx.DiGraph(
        (room, other)
        for room, imported in _arrows().items()
        for other in imported
        if height[other] < height[room]
    )
    return sorted(networkx.transitive_reduction(down).edges)


def picture() -> str:
    """Returns the picture as SVG: a band for each layer, an arrow for each import of a room."""
    layers, _, _ = _layers()
    places: dict[str, tuple[float, float]] = {}
    (width, height), bend = _BOX, 0.6 * _BAND
    for row, layer in enumerate(layers):
        for column, room in enumerate(layer):
            share = _ALONE[row % 3] if len(layer) == 1 else (column + 1) / (len(layer) + 1)
            places[room] = (round(_WIDTH * share, 1), row * _BAND + _BAND / 2)
    total = len(layers) * _BAND
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {total}" '
        'font-family="sans-serif" font-size="13" text-anchor="middle">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="#78909c"/></marker></defs>',
    ]
    for row in range(len(layers)):
        fill = "#f5f7f8" if row % 2 else "#e8edf0"
        parts.append(f'<rect y="{row * _BAND}" width="{_WIDTH}" height="{_BAND}" fill="{fill}"/>')
    for room, other in _shown_arrows():
        (x, y), (to_x, to_y) = places[room], places[other]
        parts.append(
            f'<path d="M{x} {y + height / 2}C{x} {y + bend:.1f} {to_x} {to_y - bend:.1f} '
            f'{to_x} {to_y - height / 2}" fill="none" stroke="#78909c" marker-end="url(#tip)"/>'
        )
    for room, (x, y) in places.items():
        parts.append(
            f'<rect x="{x - width / 2}" y="{y - height / 2}" width="{width}" height="{height}" '
            f'rx="6" fill="#fff" stroke="#455a64"/><text x="{x}" y="{y + 4.5}">{room}</text>'
        )
    return "\n".join([*parts, "</svg>"]) + "\n"


def draw_house() -> Path:
    """Draws the picture; returns the file."""
    FIGURE.write_text(picture(), encoding="utf-8")
    return FIGURE
