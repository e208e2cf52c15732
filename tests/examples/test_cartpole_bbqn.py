"""BBQN and a DQN on CartPole: they run, and nothing of dialogue comes along."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "examples" / "cartpole_bbqn.py"

# Runs the script as a person does, then says what was imported for it.
WATCHED = """
import json, runpy, sys
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
print(json.dumps(sorted(name for name in sys.modules if name.startswith("bbq_torchrl"))))
"""


@pytest.fixture(scope="module")
def short_run() -> list[str]:
    """The lines that the example's short form prints, and last the package's modules, as JSON."""
    pytest.importorskip("gymnasium")
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(SCRIPT), "--frames", "64"],
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Warning" not in done.stderr, done.stderr
    return done.stdout.splitlines()


def test_the_short_form_runs(short_run):
    line = re.fullmatch(
        r"mean network, 20 episodes: return (\d+\.\d) of at most 500", short_run[-2]
    )
    assert line is not None, short_run
    assert 1 <= float(line[1]) <= 500


def test_nothing_of_dialogue_is_imported(short_run):
    packages = {name.split(".")[1] for name in json.loads(short_run[-1]) if "." in name}
    assert packages == {"bayes", "exploration", "networks", "objectives"}


def test_the_dqn_learns_in_the_same_loop():
    pytest.importorskip("gymnasium")
    example = runpy.run_path(str(SCRIPT))
    assert 1 <= example["train"]("dqn", 64, 0) <= 500


def test_the_dqn_explores_less_and_less():
    pytest.importorskip("gymnasium")
    example = runpy.run_path(str(SCRIPT))
    _, explore, _ = example["make_agent"]("dqn", example["make_env"](0), 400)
    assert float(explore[-1].eps) == 1
    explore[-1].step(50)
    assert float(explore[-1].eps) == pytest.approx((1 + 0.05) / 2, rel=1e-4)  # summed up in float32
    explore[-1].step(100)
    assert float(explore[-1].eps) == pytest.approx(0.05)
