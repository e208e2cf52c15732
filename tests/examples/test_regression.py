"""The regression example: it runs, and uncertainty grows where there are no data."""

from __future__ import annotations

import re

import forked
from extended import EXAMPLES

SCRIPT = EXAMPLES / "regression.py"


def test_the_short_form_runs_and_saves_a_figure(tmp_path):
    out = tmp_path / "new" / "figure.png"

    text, _ = forked.run_script(SCRIPT, "--steps", "20", "--out", str(out), cwd=tmp_path)

    assert re.search(r"spread of the draws off the data / on the data: \d+\.\d\n", text)
    assert out.read_bytes().startswith(b"\x89PNG")


def test_uncertainty_grows_where_there_are_no_data(example):
    x, y = example["curve"](200)

    net = example["train_bayesian"](x, y, 300)

    assert example["spread_ratio"](net) > 1.5
