"""Runs that never ran, and the reports on them."""

import pytest
from result_folders import make_run

from bbq_torchrl.evaluation.compare_runs import main


@pytest.fixture
def add(tmp_path):
    """Adds a finished run, numbered unless it has a name. Returns its folder; see ``make_run``."""
    names = map(str, range(100))

    def added(rates, name=None, **settings):
        return make_run(tmp_path / "runs" / (name or next(names)), rates, **settings)

    return added


@pytest.fixture
def report(tmp_path, capsys):
    """Reports on all runs, or on those named. Returns what is printed, or why it is refused."""

    def reported(*options, runs=(tmp_path / "runs",), code=0):
        assert main([*map(str, runs), *options]) == code
        return capsys.readouterr()[1 if code else 0]

    return reported
