"""Processes to harm, undisturbed runs, and the counts of attempts.

``BBQ_RECORD=<file>`` has the counts written, as JSON, once everything has passed. Test files that
are run one after the other, each with the same numbers, add to one record.
"""

import json
import os
import random
import signal
from collections import Counter
from pathlib import Path

import pytest

from .cases import CONFIGURATIONS, DAMAGES, KILLS, SEED
from .commands import Commands
from .folders import Reference

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Background commands of a shell ignore Ctrl-C, and their child processes inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)

OUTCOMES = Counter()
"""``<attempt>: <outcome>`` -> its count in the tests that passed."""


def pytest_runtest_logreport(report):
    if report.when == "call" and report.passed:
        for name, times in report.user_properties:
            OUTCOMES[name] += times


def pytest_sessionfinish(session, exitstatus):
    file = os.environ.get("BBQ_RECORD")
    is_worker = hasattr(session.config, "workerinput")  # of pytest-xdist
    if file and exitstatus == 0 and not is_worker:
        sizes = f"BBQ_KILLS={KILLS} BBQ_DAMAGES={DAMAGES}"
        found = {"command": f"{sizes} scripts/check adversary", "outcomes": dict(OUTCOMES)}
        path = Path(file)
        before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        if before.get("command") == found["command"]:
            found["outcomes"] = dict(sorted({**before["outcomes"], **OUTCOMES}.items()))
        path.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


@pytest.fixture(scope="session")
def commands(tmp_path_factory):
    return Commands(tmp_path_factory.mktemp("adversary"))


@pytest.fixture
def rng(request):
    print(f"BBQ_SEED={SEED}")
    return random.Random(f"{SEED} {request.node.name}")


@pytest.fixture(scope="session")
def references(commands):
    """Makes, once for each configuration, an undisturbed run."""
    made = {}

    def of(name):
        if name not in made:
            folder = Path(commands.folder) / f"reference-{name}"
            ended = commands.run("train", *CONFIGURATIONS[name], f"hydra.run.dir={folder}")
            made[name] = Reference(folder, CONFIGURATIONS[name], ended.seconds)
        return made[name]

    return of
