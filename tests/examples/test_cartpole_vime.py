"""The CartPole example runs as its text says, and with parts that know no dialogue."""

from __future__ import annotations

import re
from pathlib import Path

import forked
import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "cartpole_vime.py"


def test_the_short_form_trains_and_reports_the_tasks_return(tmp_path):
    pytest.importorskip("gymnasium")
    out, _ = forked.run_script(EXAMPLE, "--frames", "300", cwd=tmp_path)
    reported = re.fullmatch(r"mean return of the last 10 episodes: ([\d.]+)", out.splitlines()[-1])
    assert reported is not None, out
    assert 5 < float(reported[1]) < 300


def test_it_takes_nothing_of_dialogue_along():
    imported = set(re.findall(r"from (bbq_torchrl\.\w+)", EXAMPLE.read_text()))
    assert imported == {
        "bbq_torchrl." + room for room in ("exploration", "networks", "objectives", "vime")
    }
