"""Bad input is refused in one short sentence, and leaves no files behind.

A row of the table ``bad_input.yaml`` has the command, the damage to its folder, and a part of the
sentence. All rows without damage are tested, and a sample of the others.
"""

from __future__ import annotations

import importlib
import random
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import forked
import pytest
import yaml

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import run

from .cases import INPUTS, SEED, TINY
from .commands import PROGRAMS

TABLE = yaml.safe_load((Path(__file__).parent / "bad_input.yaml").read_text(encoding="utf-8"))
PLAIN = [row for row in TABLE if "damage" not in row]
DAMAGED = [row for row in TABLE if "damage" in row]
LONG = {"<long>": "x" * 2_000_000, "<deep>": "[" * 50_000, "<digits>": "9" * 5_000}
"""Texts that are too long for the table."""

LONGEST = 1_500
"""Limit on the characters of a message, which may list everything that is allowed."""

LOCKS = (".lock", ".search.lock")

DOMAIN = forked.ROOT / "tests" / "data" / "restaurant"
RUN = (
    *TINY,
    "agent=dqn",
    "explore=greedy",
    "agent.hidden=[8]",
    "protocol.rounds=3",
    "protocol.checkpoint_every=10",
    "protocol.eval_every=1",
    "domain=folder",
    f"domain.path={DOMAIN}",
)


@pytest.fixture(scope="module")
def undamaged(tmp_path_factory):
    """A working directory with a domain, a finished run that can be resumed, and so on."""
    folder = tmp_path_factory.mktemp("undamaged") / "place"
    (folder / "taken").mkdir(parents=True)
    (folder / "afile").write_text("a file\n")
    shutil.copytree(DOMAIN, folder / "domain")
    for module in (*PROGRAMS.values(), "bbq_torchrl.search.study"):
        importlib.import_module(module)  # so that the children need not
    # In a child: this process, whose children are interrupted elsewhere, is still starting.
    forked.call(lambda: run(compose(RUN), folder / "run") and 0, cwd=folder)
    return folder


@pytest.fixture
def place(tmp_path, undamaged):
    """Makes a separate working directory for a test, and damages its content."""

    def made(damage):
        folder = shutil.copytree(undamaged, tmp_path / "place")
        if damage:
            subprocess.run(["bash", "-ec", damage], cwd=folder, check=True)
        return folder

    return made


def arguments(text):
    words = shlex.split(text)
    for name, written in LONG.items():
        words = [word.replace(name, written) for word in words]
    return words


def paths(folder):
    return {path.relative_to(folder) for path in folder.rglob("*")}


def left_in(folder, before):
    """The new files and folders, except for locks and folders that contain nothing else."""
    new = paths(folder) - before
    locks = {path for path in new if path.name in LOCKS}
    return new - locks - {parent for path in locks for parent in path.parents}


def identity(row):
    return re.sub(r"\W+", "-", f"{row['command']} {row.get('damage', '')}")[:80]


def refuse(row, folder):
    """Runs the command of a row in a child of this process, and checks how it ends."""
    before = paths(folder)
    program, _, rest = row["command"].partition(" ")
    main = importlib.import_module(PROGRAMS[program]).main
    code, _, err = forked.end(main, *arguments(rest), cwd=folder)
    assert code in (1, 2), err
    assert "Traceback" not in err
    message = " ".join(err.split())
    assert " ".join(row["says"].split()) in message, err
    assert len(err) < LONGEST
    first, *rest = err.splitlines()
    if first.startswith("usage: "):  # from argparse
        assert rest[-1].partition(": ")[2].startswith("error: ")
    else:
        assert first.startswith("error: ")
        assert not rest or re.search(r"has \d+ faults:$", first)
        assert all(line.startswith("  ") for line in rest)
    assert not left_in(folder, before)


@pytest.mark.parametrize("row", PLAIN, ids=identity)
def test_what_cannot_be_done_is_a_sentence(undamaged, row):
    refuse(row, undamaged)


@pytest.mark.slow
@pytest.mark.parametrize(
    "row", random.Random(SEED).sample(DAMAGED, min(INPUTS, len(DAMAGED))), ids=identity
)
def test_what_is_damaged_is_a_sentence(place, row, record_property):
    refuse(row, place(row["damage"]))
    record_property("bad inputs: refused in a sentence", 1)


def test_a_table_has_no_row_twice():
    rows = [(row["command"], row.get("damage")) for row in TABLE]
    assert len(set(rows)) == len(rows) >= 200
