"""Bad input is refused in a message that names the fault, and leaves no files behind.

A row of the table ``bad_input.yaml`` has the command, the damage to its folder, and a part of the
message, or a list of parts: keys, files or values; and its exit code, where only a process shows
what is printed. One row of each way to refuse is tested daily, all rows nightly.
"""

import importlib
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import forked
import pytest
import yaml
from runs.trusted import DQN
from tiny import composed, prepared

from bbq_torchrl.cli.console import COMMANDS
from bbq_torchrl.runs.train import run
from bbq_torchrl.utils.text import sentence

TABLE = yaml.safe_load((Path(__file__).parent / "bad_input.yaml").read_text(encoding="utf-8"))

LOCKS = (".lock", ".search.lock", ".process")

DOMAIN = forked.ROOT / "tests" / "data" / "restaurant"
RUN = (*DQN, "protocol.keep_checkpoints=last", "protocol.eval_every=1")
RUN += ("agent.hidden=[8]", "domain=folder", f"domain.path={DOMAIN}")


@pytest.fixture(scope="module")
def undamaged(tmp_path_factory):
    """A working directory with a domain, a finished run that can be resumed, and so on."""
    folder = tmp_path_factory.mktemp("undamaged") / "place"
    (folder / "taken").mkdir(parents=True)
    (folder / "afile").write_text("a file\n")
    shutil.copytree(DOMAIN, folder / "domain")
    run(composed(*RUN), folder / "run")
    return folder


@pytest.fixture
def place(tmp_path, undamaged, monkeypatch):
    """Makes a separate working directory for a test, and damages its content."""

    def made(damage):
        folder = shutil.copytree(undamaged, tmp_path / "place")
        if damage:
            subprocess.run(["bash", "-ec", damage], cwd=folder, check=True)
        monkeypatch.chdir(folder)
        return folder

    return made


def message_of(program, arguments, ends, folder, capsys):
    """Runs a command that must be refused. Returns its message."""
    main = importlib.import_module(COMMANDS[program][0]).main
    if ends is not None:
        code, out, err = forked.end(main, *arguments, cwd=folder)
        assert code == ends
        return out + err
    if program == "train":
        with pytest.raises((ValueError, OSError)) as caught:
            prepared(*arguments)
        return sentence(caught.value)
    try:
        code = main(arguments)
    except SystemExit as end:
        code = end.code
    assert code in (1, 2)
    return capsys.readouterr().err


def paths(folder):
    """The files of a folder, but for locks and Hydra's record of a sweep."""
    files = {path for path in folder.rglob("*") if path.is_file() and path.name not in LOCKS}
    return {path for path in files if "_sweep/" not in str(path)}


def rows():
    for row in TABLE:
        name = re.sub(r"\W+", "-", f"{row['command']} {row.get('damage', '')}")[:80]
        yield pytest.param(row, id=name, marks=() if row.get("daily") else pytest.mark.slow)


@pytest.mark.parametrize("row", list(rows()))
def test_what_cannot_be_done_is_refused_by_the_name_of_the_fault(row, place, capsys):
    folder = place(row.get("damage"))
    before = paths(folder)
    program, *arguments = shlex.split(row["command"])
    message = message_of(program, arguments, row.get("code"), folder, capsys)
    parts = row["says"] if isinstance(row["says"], list) else [row["says"]]
    assert all(part in message for part in parts)
    assert "Traceback" not in message
    assert paths(folder) == before
