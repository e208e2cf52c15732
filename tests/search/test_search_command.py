"""The command of a search on real trainings, shrunk to seconds."""

import os
import sqlite3
from pathlib import Path

import forked
import pytest
from tiny import TINY, rows

from bbq_torchrl.runs.folders import run_config
from bbq_torchrl.search.__main__ import main

pytest.importorskip("optuna", reason="needs the extra search")
pytestmark = pytest.mark.slow

SPACE = Path(__file__).with_name("dqn.yaml")
SEARCH = (f"search={SPACE}", "search.trials=8", "search.startup_trials=2", *TINY)


def command(*arguments):
    return lambda: main([*SEARCH, *arguments])


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """A search of eight trials that three processes have shared: values follow who came first."""
    folder = tmp_path_factory.mktemp("search")
    with (folder / "told.txt").open("w") as told:
        workers = [
            forked.start(command(f"search.folder={folder / 'f'}"), (), folder, told, told)
            for _ in range(3)
        ]
        codes = [os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1]) for worker in workers]
    assert codes == [0, 0, 0], (folder / "told.txt").read_text()
    return folder / "f"


def check(folder):
    """Every row of the table names the folder of a run with its values."""
    table = rows(folder / "trials.csv")
    assert [row["trial"] for row in table] == [str(number) for number in range(8)]
    for row in table:
        trained = run_config(folder / row["folder"])
        assert trained.agent.lr == float(row["agent.lr"])
        assert trained.explore.eps_init == float(row["explore.eps_init"])


def test_trials_are_reported_with_the_values_that_they_were_trained_with(searched):
    check(searched)


def test_a_folder_of_a_strange_name_has_its_database(tmp_path):
    folder = tmp_path / "a%23b#c?d"
    forked.call(command(f"search.folder={folder}", "search.trials=1"), cwd=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [folder.name]
    connection = sqlite3.connect(folder / "study.db")
    assert connection.execute("SELECT study_name FROM studies").fetchall() == [("dqn",)]
    connection.close()
