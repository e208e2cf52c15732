"""The CartPole example runs as its text says, and with parts that know no dialogue."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "cartpole_vime.py"


def test_the_short_form_trains_and_reports_the_tasks_return():
    pytest.importorskip("gymnasium")
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), "--frames", "300"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    reported = re.fullmatch(
        r"mean return of the last 10 episodes: ([\d.]+)", done.stdout.splitlines()[-1]
    )
    assert reported is not None, done.stdout
    assert 5 < float(reported[1]) < 300


def test_it_takes_nothing_of_dialogue_along():
    imported = set(re.findall(r"from (bbq_torchrl\.\w+)", EXAMPLE.read_text()))
    assert imported == {
        "bbq_torchrl." + room
        for room in ("bayes", "data", "exploration", "networks", "objectives", "vime")
    }
