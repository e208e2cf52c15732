"""Bad input is refused in a message that names the fault, and leaves no files behind.

A row of the table ``bad_input.yaml`` has the command, the damage to its folder, and a part of the
message: a key, a file or a value. One row of each way to refuse is tested daily, all rows nightly.
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
from tiny import composed, nightly, prepared

from bbq_torchrl.runs.train import run
from bbq_torchrl.utils.text import sentence

from .cases import TINY
from .commands import PROGRAMS

TABLE = yaml.safe_load((Path(__file__).parent / "bad_input.yaml").read_text(encoding="utf-8"))

LOCKS = (".lock", ".search.lock", ".process")

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


def message_of(program, arguments, capsys):
    """Runs a command that must be refused, in this process. Returns its message."""
    if program == "train":
        with pytest.raises((ValueError, OSError)) as caught:
            prepared(*arguments)
        return sentence(caught.value)
    try:
        code = importlib.import_module(PROGRAMS[program]).main(arguments)
    except SystemExit as end:
        code = end.code
    assert code in (1, 2)
    return capsys.readouterr().err


def paths(folder):
    return {path for path in folder.rglob("*") if path.is_file() and path.name not in LOCKS}


def rows():
    for row in TABLE:
        name = re.sub(r"\W+", "-", f"{row['command']} {row.get('damage', '')}")[:80]
        yield pytest.param(row, id=name, marks=() if row.get("daily") else pytest.mark.slow)


@pytest.mark.parametrize("row", list(rows()))
def test_what_cannot_be_done_is_refused_by_the_name_of_the_fault(row, place, capsys):
    folder = place(row.get("damage"))
    before = paths(folder)
    program, *arguments = shlex.split(row["command"])
    message = message_of(program, arguments, capsys)
    assert row["says"] in message
    assert "Traceback" not in message
    assert paths(folder) == before


LINES = {
    "an option": ("agent=foo", 1, "agent/foo"),
    "a job of a sweep": ("--multirun agent=foo,dqn", 1, "agent/foo"),
    "a YAML file": ("--config-dir mine agent=dqn", 2, "broken.yaml"),
    "a folder of options": ("--config-dir nowhere", 2, "nowhere"),
    "a flag": ("--nonsense", 2, "--nonsense"),
    "a missing launcher": ("--multirun hydra/launcher=slrm seed=1,2", 1, "slrm"),
    "a resumed sweep": ("--multirun hydra/launcher=basic resume=run seed=1", 1, "resume"),
}
DAILY = ("an option", "a YAML file", "a flag")  # the table has the others


@pytest.mark.parametrize("fault", nightly(LINES, DAILY))
def test_a_command_line_is_refused_without_a_traceback(fault, place):
    folder = place("mkdir -p mine/agent; echo 'a: [' > mine/agent/broken.yaml")
    line, expected, says = LINES[fault]
    main = importlib.import_module(PROGRAMS["train"]).main
    code, out, err = forked.end(main, *shlex.split(line), cwd=folder)
    assert code == expected
    assert says in out + err
    assert "Traceback" not in out + err
    assert not list(folder.rglob("metrics.csv.new"))
