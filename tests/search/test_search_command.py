"""The command of a search on real trainings, shrunk to seconds."""

import os
from pathlib import Path

import forked
import pytest
from tiny import TINY, rows

from bbq_torchrl.runs.folders import run_config
from bbq_torchrl.search import main

pytest.importorskip("optuna", reason="needs the extra search")

SPACE = Path(__file__).with_name("dqn.yaml")
SEARCH = (f"search={SPACE}", "search.trials=8", "search.startup_trials=2", *TINY)


@pytest.mark.slow
def test_trials_that_processes_share_are_reported_with_the_values_they_were_trained_with(tmp_path):
    folder, log = tmp_path / "f", tmp_path / "told.txt"
    with log.open("w") as told:
        workers = [
            forked.start(
                lambda: main([*SEARCH, f"search.folder={folder}"]), (), tmp_path, told, told
            )
            for _ in range(3)
        ]
        codes = [os.waitstatus_to_exitcode(os.waitpid(worker, 0)[1]) for worker in workers]
    assert codes == [0, 0, 0], log.read_text()
    table = rows(folder / "trials.csv")
    assert [row["trial"] for row in table] == [str(number) for number in range(8)]
    for row in table:  # values follow who came first
        trained = run_config(folder / row["folder"])
        assert trained.agent.lr == float(row["agent.lr"])
        assert trained.explore.eps_init == float(row["explore.eps_init"])
