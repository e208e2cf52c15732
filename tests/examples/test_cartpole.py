"""BBQN, a DQN and VIME on CartPole: the examples run, and nothing of dialogue comes along."""

from __future__ import annotations

import re
import runpy

import forked
import pytest
from extended import EXAMPLES


@pytest.mark.parametrize(
    ("name", "frames", "said"),
    [
        ("bbqn", "64", r"mean network, 20 episodes: return (\d+\.\d) of at most 500"),
        ("vime", "300", r"mean return of the last 10 episodes: ([\d.]+)"),
    ],
)
def test_the_short_form_runs_and_tells_the_tasks_return(tmp_path, name, frames, said):
    pytest.importorskip("gymnasium")
    script = EXAMPLES / f"cartpole_{name}.py"
    out, err = forked.run_script(script, "--frames", frames, cwd=tmp_path)
    # The child ends at once, so that Python's own tracker may tell of what it leaves behind.
    warned = [line for line in err.splitlines() if "Warning" in line]
    assert all("resource_tracker" in line for line in warned), err
    line = re.fullmatch(said, out.splitlines()[-1])
    assert line is not None, out
    assert 1 <= float(line[1]) <= 500


@pytest.mark.parametrize(
    ("name", "rooms"),
    [
        ("bbqn", {"bayes", "exploration", "networks", "objectives"}),
        ("vime", {"exploration", "networks", "objectives", "vime"}),
    ],
)
def test_it_takes_nothing_of_dialogue_along(name, rooms):
    text = (EXAMPLES / f"cartpole_{name}.py").read_text()
    assert set(re.findall(r"(?:from|import) bbq_torchrl\.(\w+)", text)) == rooms


def test_the_dqn_explores_less_and_less():
    pytest.importorskip("gymnasium")
    example = runpy.run_path(str(EXAMPLES / "cartpole_bbqn.py"))
    _, explore, _ = example["make_agent"]("dqn", example["make_env"](0), 400)
    assert float(explore[-1].eps) == 1
    explore[-1].step(50)
    assert float(explore[-1].eps) == pytest.approx((1 + 0.05) / 2, rel=1e-4)  # summed up in float32
    explore[-1].step(100)
    assert float(explore[-1].eps) == pytest.approx(0.05)
