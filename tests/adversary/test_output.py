"""Unwritable standard output and standard error: no traceback, the right exit code."""

import os
import subprocess
import sys

import pytest
from forked import ROOT, environment

from .cases import TINY

pytestmark = pytest.mark.slow

TRAIN = str(ROOT / "train.py")
COMMANDS = {
    "evaluate": ("-m", "bbq_torchrl.cli.console", "evaluate", "policy=rule", "dialogues=2"),
    "report --help": ("-m", "bbq_torchrl.cli.console", "report", "--help"),
    "bbq": ("-m", "bbq_torchrl.cli.console"),
}


def ended(arguments, cwd, *, redirection="", **streams):
    """Runs a command with a redirection of the shell; returns exit code and standard error."""
    given = {name: text for name, text in environment().items() if name != "PYTHONUNBUFFERED"}
    given |= streams.pop("buffering", {})
    shell = ["sh", "-c", f'exec "$@" {redirection}', "sh", sys.executable]
    streams = {"stderr": subprocess.PIPE, **streams}
    done = subprocess.run([*shell, *arguments], cwd=cwd, env=given, text=True, **streams)
    return done.returncode, done.stderr


@pytest.mark.parametrize("buffering", [{}, {"PYTHONUNBUFFERED": "1"}], ids=["buffered", "not"])
@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_what_cannot_be_printed_is_no_traceback(tmp_path, command, buffering):
    read, write = os.pipe()
    os.close(read)
    end = ended(command, tmp_path, stdout=write, buffering=buffering)
    os.close(write)
    assert end == (141, "")
    code, line = ended(command, tmp_path, redirection="> /dev/full", buffering=buffering)
    assert code == 1
    assert "No space left on device" in line


@pytest.mark.parametrize("redirection", ["2> /dev/full", "2>&-"])
def test_a_refusal_that_cannot_be_printed_has_its_exit_code(tmp_path, redirection):
    assert ended((TRAIN, "agent.lr=0"), tmp_path, redirection=redirection)[0] == 2


def test_a_run_that_cannot_log_on_standard_output_is_a_run(tmp_path):
    keys = ("agent=dqn", *TINY, "hydra.run.dir=run")
    ended((TRAIN, *keys), tmp_path, redirection="> /dev/full 2> /dev/full")
    assert (tmp_path / "run" / "result.json").is_file()
