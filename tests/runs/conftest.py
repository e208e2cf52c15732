"""Runs that the tests of run folders share."""

import shutil
from pathlib import Path

import forked
import pytest
from tiny import TINY, composed, without_drawing

from bbq_torchrl.runs.train import main, run

from .trusted import DQN

SMALL = (*TINY, "protocol.rounds=3", "protocol.eval_dialogues=30", "protocol.eval_batch=30")


@pytest.fixture(scope="session")
def kept(tmp_path_factory):
    """A finished run with everything that resuming needs."""
    folder = tmp_path_factory.mktemp("kept") / "run"
    with without_drawing():
        run(composed(*DQN, "protocol.keep_checkpoints=last"), folder)
    return folder


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A finished run as it is by default: its weights are left."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    with without_drawing():
        run(composed(*DQN), folder)
    return folder


@pytest.fixture(scope="session")
def commanded(tmp_path_factory):
    """A run of three replicas, from the command of the README on a shrunk protocol."""
    folder = tmp_path_factory.mktemp("cli") / "run"
    growing = "env=domain_ext env.start=1 env.every=1"
    command = f"agent=bbqn explore=thompson {growing} replicas=3 seed=7 device=cpu".split()
    forked.call(main, *command, *SMALL, f"hydra.run.dir={folder}", cwd=folder.parent)
    return folder


@pytest.fixture
def copy(tmp_path):
    def copied(folder):
        return Path(shutil.copytree(folder, tmp_path / "run"))

    return copied
