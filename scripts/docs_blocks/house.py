"""The rooms of the package, their layers and imports: a table and a picture."""

from __future__ import annotations

import importlib
import re
from functools import cache

import grimp
import matplotlib as mpl
import networkx
from importlinter import api
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch
from matplotlib.path import Path

from scripts.docs_blocks.common import FIGURES, ROOT, block, code, table

PACKAGE = "bbq_torchrl"
FIGURE = FIGURES / "house.svg"

_ALONE = (0.22, 0.5, 0.78)  # positions of a room that is alone in its layer, so that arrows pass
_BOX = {"boxstyle": "round", "facecolor": "white", "edgecolor": "#455a64"}
_ARROW = {"arrowstyle": "->", "mutation_scale": 10, "color": "#78909c"}
_CURVE = [Path.MOVETO, *[Path.CURVE4] * 3]


@cache
def _house() -> tuple[list[list[str]], networkx.DiGraph]:
    """Returns the layers of the contract, highest first, and the graph of imports.

    The graph includes packages outside the contract and excludes the contract's exceptions.
    """
    contract, *_ = api.read_configuration(str(ROOT / ".importlinter"))["contracts_options"]
    layers = [re.findall(rf"{PACKAGE}\.([\w.]+)", layer) for layer in contract["layers"]]
    graph = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True, cache_dir=None)
    for importer, imported in (line.split(" -> ") for line in contract["ignore_imports"]):
        graph.remove_import(importer=importer, imported=imported)
    packages = {file.parent.name for file in (ROOT / PACKAGE).glob("*/__init__.py")}
    named = {room.partition(".")[0] for layer in layers for room in layer}
    others = sorted(packages - named)
    rooms = {f"{PACKAGE}.{room}": room for layer in (others, *layers) for room in layer}
    house = networkx.DiGraph()
    house.add_nodes_from(rooms.values())
    for module in rooms:
        graph.squash_module(module)
    for module, room in rooms.items():
        imported = graph.find_modules_directly_imported_by(module) & rooms.keys() - {module}
        house.add_edges_from((room, rooms[other]) for other in imported)
    return layers, house


@block("house.rooms")
def _table() -> str:
    """Returns a row for each room, from the highest layer down to layer 1."""
    layers, house = _house()
    height = {room: len(layers) - row for row, layer in enumerate(layers) for room in layer}
    rows = []
    for room in house:
        text = importlib.import_module(f"{PACKAGE}.{room}").__doc__ or ""
        holds = text.partition("\n\n")[0].replace("\n", " ").replace("``", "`").rstrip(".")
        rows.append((height.get(room, "–"), code(room), holds))
    return table(("layer", "room", "holds"), rows)


def draw_house() -> None:
    """Draws the rooms in layers, without arrows that follow from two others."""
    layers, house = _house()
    places = {
        room: (_ALONE[row % 3] if len(layer) == 1 else (column + 0.5) / len(layer), -row)
        for row, layer in enumerate(layers)
        for column, room in enumerate(layer)
    }
    inside = house.subgraph(places).edges
    down = [(room, other) for room, other in inside if places[other][1] < places[room][1]]
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "house"}):
        figure = Figure(figsize=(8, 7), layout="constrained")
        ax = figure.add_subplot(ylim=(0.5 - len(layers), 0.5))
        ax.axis("off")
        for row in range(0, len(layers), 2):
            ax.axhspan(-row - 0.5, -row + 0.5, color="#eef1f3", zorder=0)
        for room, other in sorted(networkx.transitive_reduction(networkx.DiGraph(down)).edges):
            (x, y), (to_x, to_y) = places[room], places[other]
            way = Path(
                [(x, y - 0.25), (x, y - 0.7), (to_x, to_y + 0.7), (to_x, to_y + 0.25)], _CURVE
            )
            ax.add_patch(FancyArrowPatch(path=way, **_ARROW))
        for room, place in places.items():
            ax.text(*place, room, ha="center", va="center", bbox=_BOX)
        figure.savefig(FIGURE, metadata={"Date": None})
