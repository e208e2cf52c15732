"""The rooms: what the page of the house says, what an import loads, and which names are public."""

from __future__ import annotations

import importlib
import re

import forked
import grimp
import pytest

from scripts.docs_blocks import house

from .pages import ROOT

PAGE = (ROOT / "docs" / "how_it_works.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| (\d+|–) \| `([\w.]+)` \| ", PAGE, re.MULTILINE)
PARTS = ("bayes", "networks", "exploration")


def test_every_package_has_a_row():
    packages = {file.parent.name for file in (ROOT / "bbq_torchrl").glob("*/__init__.py")}
    assert packages <= {room.partition(".")[0] for _, room in ROWS}


def test_the_layers_are_those_of_the_contract():
    contract = (ROOT / ".importlinter").read_text(encoding="utf-8")
    section = contract.partition("\nlayers =\n")[2].partition("\nignore_imports")[0]
    lines = [re.findall(r"bbq_torchrl\.([\w.]+)", line) for line in section.splitlines()]
    layers = {room: int(layer) for layer, room in ROWS if layer != "–"}
    expected = {room: len(lines) - row for row, rooms in enumerate(lines) for room in rooms}
    assert {room: layers[room] for room in expected} == expected


def test_the_picture_has_the_rooms_and_arrows_of_today(tmp_path, monkeypatch):
    kept = house.FIGURE.read_text(encoding="utf-8")
    monkeypatch.setattr(house, "FIGURE", tmp_path / "house.svg")
    house.draw_house()
    parts = re.compile(r'id="(patch_\d+)"|>([\w.]+)</text>')  # what another matplotlib draws, too
    drawn = parts.findall(house.FIGURE.read_text(encoding="utf-8"))
    assert len(drawn) > 40
    assert parts.findall(kept) == drawn, "run python scripts/write_docs.py"


def circles(graph):
    """The sets of modules that import one another, by Tarjan's algorithm."""
    order, lowest, path, found = {}, {}, [], []

    def visit(module):
        order[module] = lowest[module] = len(order)
        path.append(module)
        for other in graph.find_modules_directly_imported_by(module):
            if other not in order:
                visit(other)
            if other in path:
                lowest[module] = min(lowest[module], lowest[other])
        if lowest[module] == order[module]:
            place = path.index(module)
            if len(path) - place > 1:
                found.append(sorted(path[place:]))
            del path[place:]

    for module in sorted(graph.modules):
        if module not in order:
            visit(module)
    return found


def test_no_two_files_import_one_another():
    graph = grimp.build_graph("bbq_torchrl", exclude_type_checking_imports=False)
    # The package offers load_run and train, imported when they are used.
    for name in graph.find_modules_directly_imported_by("bbq_torchrl"):
        graph.remove_import(importer="bbq_torchrl", imported=name)
    assert len(graph.modules) > 100
    assert circles(graph) == []


def test_a_circle_is_found():
    graph = grimp.ImportGraph()
    for importer, imported in ("ab", "bc", "ca", "cd"):
        graph.add_import(importer=importer, imported=imported)
    assert circles(graph) == [["a", "b", "c"]]


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


def test_options_need_no_torch_dialogues_no_torchrl_and_the_parts_no_dialogue():
    asked, _ = forked.python("-c", PROGRAM, cwd=ROOT)
    assert asked.split() == ["numpy", "tensordict", "torch", "torchrl"]


def test_domains_have_no_neural_network():
    for file in (ROOT / "bbq_torchrl" / "domains").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"\btorch\.nn\b|from torch import .*\bnn\b", text), file.name


def public(part):
    return set(importlib.import_module(f"bbq_torchrl.{part}").__all__)


@pytest.mark.parametrize("part", PARTS)
def test_public_names_are_those_of_the_pages(part):
    parts = (ROOT / "docs" / "parts.md").read_text(encoding="utf-8")
    table = parts.partition(f"| `bbq_torchrl.{part}` |")[2].partition("\n\n")[0]
    listed = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| ([^|]*) \|", table, re.MULTILINE)))
    api = (ROOT / "docs" / "api" / f"{part}.md").read_text(encoding="utf-8")
    shown = re.findall(rf"^::: bbq_torchrl\.{part}\.(\w+)$", api, re.MULTILINE)
    assert sorted(listed) == sorted(shown) == sorted(public(part))


def test_public_names_are_about_25():
    assert sum(len(public(part)) for part in PARTS) <= 25


def test_the_example_package_uses_public_names_only():
    for file in (ROOT / "examples" / "extending").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        for part, names in re.findall(r"from bbq_torchrl\.(\w+) import ([\w, ]+)", text):
            if part in PARTS:
                assert {name.strip() for name in names.split(",")} <= public(part), file.name
        deeper = re.findall(rf"from bbq_torchrl\.((?:{'|'.join(PARTS)})\.\w+)", text)
        assert deeper == [], file.name
