"""Runs that the tests of run folders share, and how a refusal is read."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

import train
from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.train import REFUSED
from bbq_torchrl.run import run

from .trusted import TINY, one_line

sys.path.append(str(Path(__file__).resolve().parents[1] / "trainers"))  # planted.py


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A finished run with all that it takes to go on."""
    folder = tmp_path_factory.mktemp("kept") / "run"
    run(compose([*TINY, "protocol.keep_checkpoints=last"]), folder)
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run as it is by default: its weights are left."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    run(compose(TINY), folder)
    return folder


@pytest.fixture
def copy(tmp_path):
    def copied(folder):
        return Path(shutil.copytree(folder, tmp_path / "run"))

    return copied


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Runs a command line of train.py that is refused. Returns its one line."""
    place = tmp_path / "here"
    place.mkdir()
    monkeypatch.chdir(place)

    def command(*arguments):
        monkeypatch.setattr(sys, "argv", ["train.py", *arguments])
        with pytest.raises(SystemExit) as end:
            train.main()
        assert end.value.code == REFUSED
        return one_line(capsys)

    return command
