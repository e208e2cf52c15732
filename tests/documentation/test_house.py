"""The rooms: what the page says, what an import loads, and which names are public."""

import importlib
import re

import forked
import grimp
import networkx
import pytest

from scripts.docs_blocks import house

from .pages import ROOT

PAGE = (ROOT / "docs" / "how_it_works.md").read_text(encoding="utf-8")
PARTS = ("bayes", "networks", "exploration")
LAYERS = {room: layer for layer, room in re.findall(r"^\| (\d+|–) \| `([\w.]+)` \| ", PAGE, re.M)}


def test_every_room_has_a_row_in_the_layer_of_the_contract():
    packages = {file.parent.name for file in (ROOT / "bbq_torchrl").glob("*/__init__.py")}
    assert packages <= {room.partition(".")[0] for room in LAYERS}
    contract = (ROOT / ".importlinter").read_text(encoding="utf-8")
    section = contract.partition("\nlayers =\n")[2].partition("\nignore_imports")[0]
    lines = [re.findall(r"bbq_torchrl\.([\w.]+)", line) for line in section.splitlines()]
    expected = {room: str(len(lines) - row) for row, rooms in enumerate(lines) for room in rooms}
    assert {room: LAYERS[room] for room in expected} == expected


def test_the_picture_has_the_rooms_and_arrows_of_today(tmp_path, monkeypatch):
    kept = house.FIGURE.read_text(encoding="utf-8")
    monkeypatch.setattr(house, "FIGURE", tmp_path / "house.svg")
    house.draw_house()
    parts = re.compile(r'id="(patch_\d+)"|>([\w.]+)</text>')  # what another matplotlib draws, too
    drawn = parts.findall(house.FIGURE.read_text(encoding="utf-8"))
    assert len(drawn) > 40
    assert parts.findall(kept) == drawn, "run python scripts/write_docs.py"


def test_the_main_job_is_read_in_twenty_files():
    _, _, rest = PAGE.partition("### From train.py to the gradient step\n")
    files = re.findall(r"^\| `(\S+\.py)` \|", rest.partition("\n### ")[0], flags=re.MULTILINE)
    lines = [(ROOT / file).read_text(encoding="utf-8").count("\n") for file in files]
    assert files[:2] == ["train.py", "bbq_torchrl/runs/train.py"]
    assert len(files) <= 20
    assert sum(lines) <= 3_500


def test_no_two_files_import_one_another():
    graph = grimp.build_graph("bbq_torchrl", exclude_type_checking_imports=False)
    # The package offers load_run and train, imported when they are used.
    for name in graph.find_modules_directly_imported_by("bbq_torchrl"):
        graph.remove_import(importer="bbq_torchrl", imported=name)
    assert len(graph.modules) > 100
    imports = networkx.DiGraph(
        (name, other)
        for name in graph.modules
        for other in graph.find_modules_directly_imported_by(name)
    )
    assert [of for of in networkx.strongly_connected_components(imports) if len(of) > 1] == []


# One process, since importing torch and torchrl takes seconds: what loads little comes first. The
# parts are imported anew, and watched: which libraries do the project's own modules ask for?
PROGRAM = """
import builtins, sys
sys.modules.update(dict.fromkeys(("pycrfsuite", "rapidfuzz", "httpx", "optuna")))  # not installed
import bbq_torchrl.options
bbq_torchrl.options.schemas()
import bbq_torchrl.people.study.outcomes, bbq_torchrl.people.study.report
loaded = {"torch", "starlette", "jinja2", "uvicorn"} & set(sys.modules)
assert not loaded, f"options or a study's report load {loaded}"
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
builtins.__import__ = real
import bbq_torchrl.people.language, bbq_torchrl.search  # without their extras
print(*sorted(asked - sys.stdlib_module_names - {"bbq_torchrl"}))
"""


@pytest.mark.slow
def test_options_need_no_torch_dialogues_no_torchrl_and_the_parts_no_dialogue():
    asked, _ = forked.python("-c", PROGRAM, cwd=ROOT)
    assert asked.split() == ["numpy", "tensordict", "torch", "torchrl"]


def test_public_names_are_few_and_on_the_page_of_parts():
    names = {part: set(importlib.import_module(f"bbq_torchrl.{part}").__all__) for part in PARTS}
    assert sum(map(len, names.values())) <= 25
    page = (ROOT / "docs" / "parts.md").read_text(encoding="utf-8")
    for part in PARTS:
        assert f"\n::: bbq_torchrl.{part}\n" in page  # shows what __all__ names
    for file in (ROOT / "examples" / "extending").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        for part, used in re.findall(r"from bbq_torchrl\.(\w+) import ([\w, ]+)", text):
            assert {name.strip() for name in used.split(",")} <= names.get(
                part, {*used.split(", ")}
            )
        assert not re.findall(rf"from bbq_torchrl\.(?:{'|'.join(PARTS)})\.\w+", text), file.name
