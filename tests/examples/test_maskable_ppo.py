"""Another library's maskable agent plays the dialogues: the example runs."""

from __future__ import annotations

import re
import runpy
import sys

import pytest
from extended import EXAMPLES

SCRIPT = EXAMPLES / "maskable_ppo.py"


@pytest.mark.slow
def test_maskable_ppo_learns_for_a_moment(monkeypatch, capsys):
    pytest.importorskip("sb3_contrib")
    short = ["--steps", "128", "--batch", "64", "--dialogues", "5"]
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), *short])
    runpy.run_path(str(SCRIPT), run_name="__main__")
    said = capsys.readouterr().out
    line = re.fullmatch(r"MaskablePPO, 128 turns: success rate (\d\.\d{3})\n", said)
    assert line is not None, said
    assert 0 <= float(line[1]) <= 1
