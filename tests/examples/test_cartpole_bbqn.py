"""BBQN and a DQN on CartPole: they run, and nothing of dialogue comes along."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import forked
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "examples" / "cartpole_bbqn.py"


def test_the_short_form_runs(tmp_path):
    pytest.importorskip("gymnasium")
    out, err = forked.run_script(SCRIPT, "--frames", "64", cwd=tmp_path)
    assert "Warning" not in err, err
    line = re.fullmatch(
        r"mean network, 20 episodes: return (\d+\.\d) of at most 500", out.splitlines()[-1]
    )
    assert line is not None, out
    assert 1 <= float(line[1]) <= 500


def test_it_takes_nothing_of_dialogue_along():
    imported = set(re.findall(r"(?:from|import) (bbq_torchrl\.\w+)", SCRIPT.read_text()))
    rooms = ("bayes", "exploration", "networks", "objectives")
    assert imported == {f"bbq_torchrl.{room}" for room in rooms}


def test_the_dqn_explores_less_and_less():
    pytest.importorskip("gymnasium")
    example = runpy.run_path(str(SCRIPT))
    _, explore, _ = example["make_agent"]("dqn", example["make_env"](0), 400)
    assert float(explore[-1].eps) == 1
    explore[-1].step(50)
    assert float(explore[-1].eps) == pytest.approx((1 + 0.05) / 2, rel=1e-4)  # summed up in float32
    explore[-1].step(100)
    assert float(explore[-1].eps) == pytest.approx(0.05)
